"""Contact-point optimization: where on the outline, in which direction and how far to push.

The cost of a push is the mean distance of the cells' centers at its predicted end from where they are at the goal pose
(`docs/theory/planning.md`, section 1).
"""

from dataclasses import dataclass
from time import perf_counter
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.reachable_outline import find_reachable_outline
from gridpush_drake.planning.contact.search import METHODS
from gridpush_drake.planning.contact.trial import ContactOptions, PlannedPush, TrialRunner, calc_goal_error
from gridpush_drake.planning.push_constraints import PushConstraints

ContactMethod = Literal["gradient", "finite_difference", "exhaustive"]

STATUS_OK = "ok"
STATUS_NO_CONTACT = "no_reachable_contact"
STATUS_NO_IMPROVEMENT = "no_improvement"

REACH_FACTOR = 1.25
"""The longest push tried is this times the farthest that a cell has to go, unless the range ends before."""


@dataclass(frozen=True, eq=False)
class ContactPlan:
    """What a contact search found.

    Attributes:
        push: the best push; None where the finger reaches no place, or no push is allowed.
        candidates: what the search ended with from each of its starts (exhaustive: the best few), best first.
        start_cost: mean cell error before the push, m.
        method: of the search.
        simulations: simulated pushes; one with its Jacobian counts as one.
        seconds: wall-clock time.
        status: "ok"; "no_improvement" where the best allowed push leaves the object no nearer to the goal;
            "no_reachable_contact" where there is none.
    """

    push: PlannedPush | None
    candidates: tuple[PlannedPush, ...]
    start_cost: float
    method: str
    simulations: int
    seconds: float
    status: str

    @property
    def cost(self) -> float:
        """Mean cell error after the best push, or without one, m."""
        return self.start_cost if self.push is None else self.push.cost


MAX_CANDIDATES = 16


@threadpool_limits.wrap(limits=1, user_api="blas")
def optimize_contact(
    obj: GridObject,
    params: CellParameters,
    pose: ArrayLike,
    goal: ArrayLike,
    *,
    method: ContactMethod = "gradient",
    constraints: PushConstraints | None = None,
    options: ContactOptions | None = None,
) -> ContactPlan:
    """Chooses the push that brings an object nearest to a goal pose.

    Args:
        obj: the object.
        params: its model.
        pose: (3,) q_W where it lies, m and rad.
        goal: (3,) where it should.
        method: "gradient", "finite_difference" (the paper's) or "exhaustive".
        constraints: table, obstacles and further rules; none by default.
        options: what pushes may be chosen from, and how.

    Returns:
        The best push and what the search cost.

    Raises:
        PlanningError: an argument is out of range, or the finger fits nowhere on the outline.
    """
    begin = perf_counter()
    if method not in METHODS:
        raise PlanningError(f"method is {method!r}; expected one of {', '.join(METHODS)}")
    options = options or ContactOptions()
    q, aim = check_pose("pose", pose), check_pose("goal", goal)
    runner = make_runner(obj, params, q, aim, constraints, options)
    trials = METHODS[method](runner)[:MAX_CANDIDATES]
    found = tuple(runner.finish(trial, runner.simulations) for trial in trials)
    start_cost = float(calc_goal_error(obj, q, aim))
    status = STATUS_NO_CONTACT if not found else STATUS_OK if found[0].cost < start_cost else STATUS_NO_IMPROVEMENT
    return ContactPlan(
        found[0] if found else None, found, start_cost, method, runner.simulations, perf_counter() - begin, status
    )


def make_runner(
    obj: GridObject, params: CellParameters, pose: Array, goal: Array, constraints: PushConstraints | None,
    options: ContactOptions,
) -> TrialRunner:  # fmt: skip
    """What simulates the pushes of a search, from a pose to a goal."""
    if params.n != obj.n:
        raise PlanningError(f"parameters of {params.n} cells; expected {obj.n}, as {obj.name} has")
    reach = find_reachable_outline(obj, options.radius, options.clearance)
    longest = float(np.linalg.norm(obj.cells_at(pose) - obj.cells_at(goal), axis=1).max())
    low, high = options.distance_range
    high = max(low, min(high, REACH_FACTOR * longest + options.clearance + low))
    checker = (constraints or PushConstraints()).start_at(obj, pose, options.radius)
    return TrialRunner(obj, params, pose, goal, reach, checker, options, (low, high))


def check_pose(name: str, pose: ArrayLike) -> Array:
    """Copies a pose (3,). Raises PlanningError where it is not three finite numbers."""
    q = np.array(pose, dtype=np.float64)
    if q.shape != (3,) or not np.isfinite(q).all():
        raise PlanningError(f"{name} is {pose!r}; expected three finite numbers (x, y, theta)")
    return q
