"""Slides to the table's edge: an object of hidden masses is explored, slid there and grasped.

It is done by the method, by the paper's two ablations, or with the true parameters; in the
quasi-static LCP world (`bench.pregrasp.world`), among bodies in MuJoCo that do not obey the model,
or in a world of the reader's own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gridpush_drake.bench.data.protocol import MASS_RANGE, PLANNING_METERS_PER_PIXEL, know_friction
from gridpush_drake.bench.pregrasp.bounds import KNOWN_FRICTION_BOUNDS, describe_fraction
from gridpush_drake.bench.pregrasp.world import PaperLearner, PreGraspOutcome, run_pregrasp
from gridpush_drake.geometry.se2 import make_direction
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.world import PushWorld
from gridpush_drake.report.table import Column, Table, calc_mean, count_of, mean_of
from gridpush_drake.units import MM_PER_M, PERCENT_PER_ONE

RECTANGLE_SIDES = (0.9, 0.7)
"""Sides of the rectangular table, m."""

ROUND_TABLE_RADIUS = 0.45
"""Radius of the round table, m."""

HEXAGON_RADIUS = 0.5
"""Distance of the hexagonal table's corners from its middle, m."""


def load_bench_object(
    name: str, friction_range: tuple[float, float], mask: Path | None = None
) -> GridObject:
    """Loads an object, of which is known between which bounds its frictions are.

    Args:
        name: name of a shipped object, or what to call the one of the mask.
        friction_range: the bounds.
        mask: file of a mask; None for a shipped object.

    Raises:
        ObjectError: there is no such object.
    """
    if mask is not None:
        obj = GridObject.from_mask(mask, meters_per_pixel=PLANNING_METERS_PER_PIXEL, name=name)
    else:
        obj = GridObject.from_yaml(find_shipped_object(name))
    return know_friction(obj, *friction_range)


def make_table(seed: int) -> SupportSurface:
    """Makes a rectangular, a round or a hexagonal table about the world's origin, in turn."""
    kind = seed % 3
    if kind == 0:
        return SupportSurface.rectangle((0.0, 0.0), RECTANGLE_SIDES)
    if kind == 1:
        return SupportSurface.round((0.0, 0.0), ROUND_TABLE_RADIUS)
    return SupportSurface.from_polygon(HEXAGON_RADIUS * make_direction(np.pi / 3 * np.arange(6)))


@dataclass(frozen=True)
class SlideScore:
    """How one run with an object ended.

    Attributes:
        name: name of the object.
        method: the method or, where truths are compared, the truth.
        outcome: how the run ended.
    """

    name: str
    method: str
    outcome: PreGraspOutcome


SLIDE_COLUMNS: dict[str, Column] = {
    "runs": len,
    "graspable, %": mean_of("grasped", PERCENT_PER_ONE),
    "dropped": count_of("dropped", True),
    "given up": lambda outcomes: sum(
        not (outcome.grasped or outcome.dropped) for outcome in outcomes
    ),
    "pokes": mean_of("pokes"),
    "slides": mean_of("slides"),
}


def tabulate_slides(scores: Sequence[SlideScore], methods: Sequence[str]) -> Table:
    """Tabulates successes, drops and refusals by method."""
    groups = [
        ((method,), [score.outcome for score in scores if score.method == method])
        for method in methods
    ]
    notes = (
        "graspable: a part hangs over the edge far enough, and the object is at rest.",
        "dropped: it fell off the table on the way. given up: no safe way was found, and it is "
        "still on the table.",
        "learned: stability for all masses that agree with the pushes; true: hidden parameters "
        "known; uniform: uniform mass, nothing learned; unbounded: the paper's identification, "
        "friction without a bound.",
        "pokes, slides: mean number of pushes.",
    )
    return Table.of(
        "Pre-grasp sliding, hidden masses and frictions", ("method",), groups, SLIDE_COLUMNS, notes
    )


FRACTION_COLUMNS: dict[str, Column] = {
    "runs": len,
    "reached, %": lambda outcomes: describe_fraction(
        sum(each.grasped for each in outcomes), len(outcomes)
    ),
    "dropped, %": lambda outcomes: describe_fraction(
        sum(each.dropped for each in outcomes), len(outcomes)
    ),
    "pokes": mean_of("pokes"),
    "slides": mean_of("slides"),
    "mm to spare": lambda outcomes: (
        MM_PER_M * calc_mean(each.margin for each in outcomes if each.grasped)
    ),
}


def tabulate_fractions(
    scores: Sequence[SlideScore], by: str, keys: Sequence[str], notes: Sequence[str]
) -> Table:
    """Tabulates successes and drops with their intervals, and says why other runs ended.

    Args:
        scores: how the runs ended.
        by: what the rows are of: truths, or bounds that were told.
        keys: the rows' names, which the scores have as their methods.
        notes: notes of the table before those on its columns.
    """
    groups = [((key,), [score.outcome for score in scores if score.method == key]) for key in keys]
    notes = (
        *notes,
        "reached: a part hangs over the edge far enough, and the object is at rest; dropped: it "
        "fell, or tilts by 10°; in brackets 95 % Wilson intervals. The other runs were given up, "
        "the object on the table.",
        "to spare: stability margin at the worst where it was reached.",
        *(
            f"{each.name}, {each.method}: {each.outcome.reason}"
            for each in scores
            if not each.outcome.grasped
        ),
    )
    return Table.of(f"Pre-grasp sliding by {by}", (by,), groups, FRACTION_COLUMNS, notes)


def tabulate_objects(scores: Sequence[SlideScore], objects: Sequence[str], method: str) -> Table:
    """Tabulates one method's runs by object."""
    groups = [
        ((name,), [s.outcome for s in scores if (s.method, s.name) == (method, name)])
        for name in objects
    ]
    return Table.of(f"Pre-grasp sliding by object, {method}", ("object",), groups, SLIDE_COLUMNS)


LEARNED_METHOD = "learned"
"""Name of the method."""

WIDE_FRICTION_METHOD = "learned, wide friction"
"""Name of the method where less is known of the friction."""

TRUE_METHOD = "true"
"""Name of the method that knows the true parameters."""

UNIFORM_METHOD = "uniform"
"""Name of the method that believes in a uniform mass."""

UNBOUNDED_METHOD = "unbounded"
"""Name of the paper's identification without a bound on the friction."""

SLIDING_METHODS = (
    LEARNED_METHOD,
    WIDE_FRICTION_METHOD,
    TRUE_METHOD,
    UNIFORM_METHOD,
    UNBOUNDED_METHOD,
)
"""Methods that slide objects to the edge."""

WIDE_FRICTION_RANGE = (0.25, 0.5)
"""Least and greatest friction of an object's parts where hardly anything is known of them."""

CONTACT_FRICTION_RANGE = (0.35, 0.65)
"""Least and greatest friction of the finger on the object."""

NO_BOUND = (0.01, 10.0)
"""Least and greatest friction that the unbounded ablation may believe in."""

MAX_ARMS = {"toolbox": 0.15}
"""Greatest distance of the grasp from where the center of mass is believed, m, of objects that
offer nothing to hold so near to their middle. This one can be taken by its edge only."""

MAX_START_OFFSET = 0.05
"""Greatest distance of the object from the table's middle at the beginning, along each axis, m."""

PAPER_PUSHES = 4
"""Number of pokes that the unbounded ablation learns from before it slides; the method decides that
itself."""


def run_method(world: PushWorld, planner: PreGraspPlanner, method: str) -> PreGraspOutcome:
    """Runs the task by a method of SLIDING_METHODS or KNOWN_FRICTION_BOUNDS."""
    if method in (LEARNED_METHOD, WIDE_FRICTION_METHOD, *KNOWN_FRICTION_BOUNDS):
        return run_pregrasp(world, planner)
    if method == UNBOUNDED_METHOD:
        paper = PaperLearner(NO_BOUND, PAPER_PUSHES)
        return run_pregrasp(world, planner, paper.learn, paper.make_inference(planner.obj))
    params = CellParameters.uniform(planner.obj)
    if method == TRUE_METHOD:
        hidden = world.truth.bodies
        assert hidden is not None
        params = hidden.params
    granted = Belief.of_parameters(Model(planner.obj, params))
    return run_pregrasp(world, planner, None, lambda found, log: granted)


def make_truth(obj: GridObject, mass_set: int) -> CellParameters:
    """Draws hidden masses and frictions by part, the frictions within what is known of them."""
    friction_range = (obj.prior.friction_min, obj.prior.friction_max)
    truth = CellParameters.random(obj, mass_set, MASS_RANGE, friction_range)
    rng = np.random.default_rng([mass_set, 1])
    return replace(truth, contact_friction=float(rng.uniform(*CONTACT_FRICTION_RANGE)))
