"""An object and a push of it, as the doors to JAX and torch are tried with."""

from dataclasses import dataclass

import numpy as np

from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.interop.differentiable import ARGUMENT_NAMES, PushSetting
from gridpush_drake.objects.grid_object import GridObject
from tests.helpers.made_identifications import make_block

REGIMES = ("quasi_static", "inertial")


@dataclass
class Case:
    """A push that turns and shifts an object.

    Attributes:
        obj: the object.
        values: its differentiable arguments by name.
    """

    obj: GridObject
    values: dict[str, np.ndarray]

    def make_setting(self, regime: str = "quasi_static", **more) -> PushSetting:
        return PushSetting(
            duration=0.5, radius=0.006, steps=25, physics=Physics(regime=regime), **more
        )


def make_case(seed: int = 0) -> Case:
    obj = make_block()
    rng = np.random.default_rng(seed)
    x0, _, _, y1 = obj.outline.bounds
    values = (
        rng.uniform(0.02, 0.1, obj.n),
        rng.uniform(0.2, 0.5, obj.n),
        np.array(0.4),
        np.array([x0 - 0.008, 0.35 * y1]),
        np.array([0.06, 0.01]),
        np.array([0.001, -0.002, 0.02]),
    )
    return Case(obj, dict(zip(ARGUMENT_NAMES, values, strict=True)))
