"""What every strategy of exploration takes and answers: `PokeStrategy` and `PokeProposal`.

A strategy is a frozen value that proposes the next poke. `RandomPokes` knows the object's shape
and draws; `DesignedPokes` takes the poke that is expected to tell most. Whoever pokes, a robot or a
bench, asks through this protocol, and can be given another strategy.

When an object is poked at all, and when enough is known, is not a strategy's affair.
"""

from dataclasses import dataclass
from typing import Protocol, TypeVar

from numpy.typing import ArrayLike

from gridpush_drake.dynamics.push import Push

MAX_REPETITION = 2
"""Greatest number of pokes that are made, in how many are wanted: not every poke is logged."""

BeliefT = TypeVar("BeliefT", contravariant=True)
"""What is believed of what is poked: a model of one object, or a belief of several."""

RulesT = TypeVar("RulesT", contravariant=True)
"""What may be reached and what must be kept clear of: `PushConstraints` for one object."""


@dataclass(frozen=True, eq=False)
class PokeProposal:
    """The next poke, or why there is none.

    Attributes:
        push: the poke; None where there is none.
        reason: why there is none, a clause; empty where there is one.
        body: number of the object that is poked, among those of the belief; 0 where there is one.
        std: present standard deviation of what matters, in the direction in which it is known
            least, m; NaN for a strategy that asks for nothing.
        expected_std: the same after the poke, as it is expected, m; NaN likewise.
        candidates: number of pokes that were looked at, with those that were passed over.
    """

    push: Push | None
    reason: str = ""
    body: int = 0
    std: float = float("nan")
    expected_std: float = float("nan")
    candidates: int = 0

    @property
    def expected_gain(self) -> float:
        """By how much the standard deviation of what matters is expected to fall, m."""
        return self.std - self.expected_std


class PokeStrategy(Protocol[BeliefT, RulesT]):
    """Something that proposes pokes."""

    def propose(self, belief: BeliefT, pose: ArrayLike, rules: RulesT) -> PokeProposal:
        """Proposes the next poke.

        Args:
            belief: what is believed of what is poked.
            pose: (3,) where the object lies, X_WB, m and rad; (N, 3) of several objects.
            rules: what may be reached, and what must be kept clear of.
        """


def lacks_pokes(wanted: int, executed: int, logged: int) -> bool:
    """Whether another poke is due: too few were written down, and not too many were made.

    Args:
        wanted: number of pokes that are wanted in the log.
        executed: number of pokes that were made.
        logged: number of pokes that could be written down.
    """
    return logged < wanted and executed < MAX_REPETITION * wanted
