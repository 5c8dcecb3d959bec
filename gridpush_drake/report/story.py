"""What a robot did with an object, told at the head of a report."""

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Story:
    """What was done, and what came of it.

    Attributes:
        verdict: in a sentence or two.
        facts: what is counted, and the count: three or four.
        figure: of it.
        caption: of the figure.
        heads: of the columns of `steps`.
        steps: what was done, in order, a row a step.
    """

    verdict: str
    facts: Sequence[tuple[str, str]]
    figure: Figure
    caption: str
    heads: tuple[str, ...]
    steps: Sequence[tuple[str, ...]]
