"""The tables of the pre-grasp benchmark."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gridpush_drake.bench.pregrasp_exploration import AIMS, ALONG, BOTH, WANTED_STD, ExplorationScore, Trace
from gridpush_drake.bench.pregrasp_world import Outcome
from gridpush_drake.bench.table import Table

PERCENT = 100.0
MM = 1e3
"""Millimetres in a metre."""

LIKELY = {BOTH: 5.991 / 2, ALONG: 3.841}
"""What 95 % of chi squares stay below, per direction: of two degrees of freedom, and of one."""

EXPLORE_COLUMNS = ("runs", "by design", "at random", "ratio", "error, mm", "at random, mm", "within 95 %, %")


@dataclass(frozen=True)
class SlideScore:
    """How one run ended.

    Attributes:
        name: of the object.
        method: of what is believed.
        outcome: the end.
        near: whether the part to be grasped is as near to the true centre of mass as asked.
    """

    name: str
    method: str
    outcome: Outcome
    near: bool = True


def tabulate_slides(scores: Sequence[SlideScore], methods: Sequence[str]) -> Table:
    """Successes, drops and refusals by method."""
    rows = []
    for method in methods:
        outcomes = [score.outcome for score in scores if score.method == method]
        grasped, dropped = sum(o.grasped for o in outcomes), sum(o.dropped for o in outcomes)
        refused = len(outcomes) - grasped - dropped
        rows.append((method, len(outcomes), PERCENT * grasped / len(outcomes), dropped, refused, *_counts(outcomes)))
    return Table(
        "Pre-grasp sliding, hidden masses and frictions",
        ("method", "runs", "graspable, %", "dropped", "given up", "pokes", "slides"),
        rows,
        (
            "graspable: a part hangs over the rim far enough, and the object is at rest.",
            "dropped: it fell off the table on the way. given up: no safe way was found, and it is still on the table.",
            "learned: stability for all masses that agree with the pushes; true: hidden parameters known; "
            "uniform: uniform mass, nothing learned; unbounded: the paper's identification, friction without a bound.",
            "pokes, slides: mean number of pushes.",
        ),
    )


def tabulate_objects(scores: Sequence[SlideScore], objects: Sequence[str], method: str) -> Table:
    """One method's runs by object."""
    rows = []
    for name in objects:
        outcomes = [score.outcome for score in scores if score.method == method and score.name == name]
        if outcomes:
            grasped, dropped = sum(o.grasped for o in outcomes), sum(o.dropped for o in outcomes)
            refused = len(outcomes) - grasped - dropped
            rows.append((name, len(outcomes), PERCENT * grasped / len(outcomes), dropped, refused, *_counts(outcomes)))
    columns = ("object", "runs", "graspable, %", "dropped", "given up", "pokes", "slides")
    return Table(f"Pre-grasp sliding by object, {method}", columns, rows)


def tabulate_exploration(scores: Sequence[ExplorationScore]) -> Table:
    """Pokes needed, by design and at random, by their length; and whether the stated spread is right."""
    rows = []
    for aim in AIMS:
        for distance in sorted({score.distance for score in scores}):
            chosen = [score for score in scores if score.aim == aim and score.distance == distance]
            if chosen:
                rows.append((aim, MM * distance, *_explore_row(aim, chosen)))
    return Table(
        f"Pokes until the centre of mass is known to {WANTED_STD * MM:.0f} mm",
        ("wanted", "poke, mm", *EXPLORE_COLUMNS),
        rows,
        (
            "by design, at random: mean number of pokes; the poke said to tell most, or any of the same pool.",
            "wanted: of the centre of mass; in both directions the least known one counts.",
            "error: mean distance of the final estimate from the true centre.",
            "within 95 %: runs of either kind whose true centre is within the 95 % range that the estimate states.",
        ),
        keys=2,
    )


def tabulate_exploration_by_object(scores: Sequence[ExplorationScore], objects: Sequence[str]) -> Table:
    """The same by object, over all lengths."""
    rows = []
    for aim in AIMS:
        for name in objects:
            chosen = [score for score in scores if score.aim == aim and score.name == name]
            if chosen:
                rows.append((aim, name, *_explore_row(aim, chosen)))
    return Table("The same by object, pokes of all lengths", ("wanted", "object", *EXPLORE_COLUMNS), rows, keys=2)


def _explore_row(aim: str, scores: Sequence[ExplorationScore]) -> tuple[float | int, ...]:
    active, random = [score.active for score in scores], [score.random for score in scores]
    designed, drawn = _mean_pokes(active), _mean_pokes(random)
    within = np.mean([trace.chi_square <= LIKELY[aim] for trace in (*active, *random)])
    return (
        len(scores), designed, drawn, designed / drawn, _mean_error(active), _mean_error(random),
        PERCENT * float(within),
    )  # fmt: skip


def _mean_pokes(traces: Sequence[Trace]) -> float:
    return float(np.mean([trace.pokes for trace in traces]))


def _mean_error(traces: Sequence[Trace]) -> float:
    return MM * float(np.mean([trace.errors[-1] for trace in traces]))


def _counts(outcomes: Sequence[Outcome]) -> tuple[float, float]:
    return float(np.mean([o.pokes for o in outcomes])), float(np.mean([o.slides for o in outcomes]))
