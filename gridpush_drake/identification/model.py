"""`Model`: objects, what their cells weigh and how they rub, and what follows from that.

A model is what one supposes of objects, or what was learned of them. It simulates pushes, predicts
those of a log, and draws parameters that may be true as well. `Identification` is a model that was
learned, and knows how surely.
"""

from dataclasses import dataclass
from typing import Literal

from numpy.typing import ArrayLike

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.motion import Motion
from gridpush_drake.dynamics.physics import Regime
from gridpush_drake.dynamics.push import ForcePush, Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import IdentificationError
from gridpush_drake.identification.prediction import Prediction, predict
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.arguments import PushLogOrFile


@dataclass(frozen=True, eq=False, init=False)
class Model(Bodies):
    """Objects, the masses and frictions of their cells, and the physics by which they slide.

    `Model(obj)` is the object as one supposes it before any push: its mass spread evenly.
    `Model(obj, params)` has given masses and frictions. The attributes are those of `Bodies`.
    """

    def simulate(
        self,
        push: Push | ForcePush,
        pose: ArrayLike = (0.0, 0.0, 0.0),
        dt: float | None = None,
        gradients: bool | Literal["mass", "push", "paper"] = False,
        *,
        regime: Regime | None = None,
        velocity: ArrayLike = (0.0, 0.0, 0.0),
        times: ArrayLike | None = None,
        record: ArrayLike | None = None,
        table: ArrayLike | None = None,
    ) -> Motion:
        """Simulates one push of the object (`docs/theory/model.md`, sections 3-6).

        The arguments, the motion that is returned, and what is raised are those of
        `dynamics.simulation.simulate`.
        """
        return simulate(
            self,
            push,
            pose,
            dt,
            gradients,
            regime=regime,
            velocity=velocity,
            times=times,
            record=record,
            table=table,
        )

    def predict(self, log: PushLogOrFile, regime: Regime | None = None) -> list[Prediction]:
        """Predicts every push of a log from its first observed pose.

        The arguments, the predictions that are returned, and what is raised are those of
        `identification.prediction.predict`.
        """
        return predict(self, log, regime)

    def draws(self, count: int, seed: int = 0) -> list[CellParameters]:
        """Draws parameters that may be true: those of the model itself, since it knows no spread.

        Args:
            count: how many.
            seed: seed of the draw.

        Returns:
            The parameters.

        Raises:
            IdentificationError: the count or the seed is negative.
            SimulationError: there are several objects.
        """
        check_draws(count, seed)
        return [self.params] * count


def check_draws(count: int, seed: int) -> None:
    """Raises IdentificationError where a number of draws or their seed is negative."""
    if count < 0 or seed < 0:
        raise IdentificationError(
            f"draws: count is {count}, seed {seed}; expected whole numbers, 0 or more"
        )
