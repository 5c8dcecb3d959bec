"""Objects of which nothing is told are slid to where they can be grasped, and weighed on the way.

Pushes are those of the pre-grasp benchmark (`bench.pregrasp.world.EdgeWorld`: quasi-static, with
loads that follow what lies on the table). Presses are made in Drake (`bench.tilt_tests.world`), on
the same object with the same masses where it lies, and nothing else of it is told but noisy
poses.
"""

from dataclasses import dataclass, replace

import numpy as np

from gridpush_drake.bench.pregrasp.world import DEFAULT_LEARNER, ONE_OBSERVATION, EdgeWorld, is_over
from gridpush_drake.bench.tilt_tests.world import (
    TABLE_EDGE,
    TiltTestNoise,
    TiltTestRun,
    TiltTestWorld,
)
from gridpush_drake.geometry.se2 import Array, compose, invert
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import Identification
from gridpush_drake.identification.tilt_tests.weighed_model import estimate_masses, hold_friction
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.loop_run import run_loop
from gridpush_drake.planning.pregrasp.goals import calc_overhangs
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.planning.pregrasp.pregrasp_loop import (
    PreGraspLoop,
    PreGraspMode,
    PreGraspState,
)
from gridpush_drake.planning.robot_status import PressStatus
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.weighing.press import PressTarget
from gridpush_drake.planning.world import FALLEN_TILT
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.weighings import MassTestLog, TiltTest

TABLE_BOUNDS = ((0.0, 0.0), (0.8, 0.8))
"""Middle and sides of the table, m."""

START_REACH = 0.05
"""Greatest distance along each axis from the table's middle at which an object begins, m."""

MAX_PRESSES = 12
"""Number of presses after which a run is given up."""


@dataclass(frozen=True)
class Story:
    """How a run ended.

    Attributes:
        grasped: whether a part truly hangs over, and the object is at rest.
        dropped: whether the object fell, in a push or a press.
        pokes: number of pokes.
        slides: number of slides.
        presses: number of presses.
        max_tilt: greatest tilt in a press, rad.
        reason: the end in a sentence.
        found: what is known in the end; None where nothing is.
    """

    grasped: bool
    dropped: bool
    pokes: int
    slides: int
    presses: int
    max_tilt: float
    reason: str
    found: Identification | None


class MassTestLearner:
    """Learns from pushes as the pre-grasp benchmark does, and adds the weighings so far.

    Attributes:
        log: the weighings so far.
    """

    def __init__(self) -> None:
        """Begins without weighings."""
        self.log = MassTestLog()

    def __call__(
        self, obj: GridObject, log: PushLog, before: Identification | None
    ) -> Identification | None:
        """Learns from the latest pushes.

        Weighings of before an object was changed, when it is learned anew, do not count any more.
        """
        if before is None:
            self.log = MassTestLog()
        # What weighings told of the frictions is held: over the edge it matters.
        weighed = before is not None and before.weighed is not None and len(self.log) > 0
        friction = hold_friction(before) if before is not None and weighed else None
        found = DEFAULT_LEARNER.learn(obj, log, before, friction)
        return found if found is before else self.weigh(found)

    def weigh(self, found: Identification | None) -> Identification | None:
        """Adds the weighings to what pushes said."""
        if found is None or not len(self.log):
            return found
        return estimate_masses(found, self.log)


def tell_story(
    obj: GridObject,
    truth: CellParameters,
    planner: PreGraspPlanner,
    seed: int,
    noise: TiltTestNoise | None = None,
) -> Story:
    """Runs the task until a part can be grasped, or to its end.

    Args:
        obj: the object, as it is known beforehand.
        truth: its true masses and frictions.
        planner: decides.
        seed: of where the object begins, and of the noise.
        noise: of poses and presses.
    """
    used = noise or TiltTestNoise()
    rng = np.random.default_rng((seed, 14))
    start = np.array([*rng.uniform(-START_REACH, START_REACH, 2), rng.uniform(-np.pi, np.pi)])
    world = EdgeWorld(
        Model(obj, truth),
        start,
        planner.surface,
        position_std=used.position,
        angle_std=used.angle,
        seed=rng,
    )
    scale = TiltTestWorld(obj, truth, noise=used, seed=seed)
    learner = MassTestLearner()
    loop = PreGraspLoop(planner, lambda *_: None, options=ONE_OBSERVATION)
    run = None
    presses = 0
    max_tilt = 0.0
    while True:
        run = run_loop(
            loop, world, _is_due, obj=obj, learn=learner, surface=planner.surface, begun=run
        )
        state = run.state
        if state.status.mode != PreGraspMode.WEIGHING or presses >= MAX_PRESSES:
            break
        assert state.press is not None
        seen = world.observe()
        assert seen is not None
        press, made = make_press(scale, state.press, world.truth.pose, seen)
        tilt = made.max_tilt
        presses += 1
        max_tilt = max(max_tilt, tilt)
        if tilt >= FALLEN_TILT:
            break
        if press is not None:
            learner.log = replace(learner.log, presses=(*learner.log.presses, press))
        presser = PressStatus(
            command_id=state.press_id,
            outcome=made.state.outcome,
            reason="the benchmark's press ended",
            weighed=press is not None,
        )
        run = replace(
            run,
            identification=learner.weigh(run.identification),
            state=loop.follow_press(state, presser),
        )
    status = run.state.status
    true = world.truth
    dropped = bool(true.fallen or max_tilt >= FALLEN_TILT)
    grasped = False
    if status.mode == PreGraspMode.VERIFYING and not dropped:
        overhangs = calc_overhangs(planner.parts, true.pose, planner.surface)
        grasped = bool(overhangs.max() >= 0 and true.stays)
    return Story(
        grasped=grasped,
        dropped=dropped,
        pokes=status.pokes,
        slides=status.slides,
        presses=presses,
        max_tilt=max_tilt,
        reason=status.reason,
        found=run.identification,
    )


def make_table() -> SupportSurface:
    """Makes the table."""
    return SupportSurface.rectangle(*TABLE_BOUNDS)


def _is_due(state: PreGraspState) -> bool:
    """Says whether a loop is done, or waits for a press."""
    return is_over(state) or state.status.mode == PreGraspMode.WEIGHING


def make_press(
    scale: TiltTestWorld, target: PressTarget, pose: Array, seen: Array
) -> tuple[TiltTest | None, TiltTestRun]:
    """Presses in Drake, whose edge is elsewhere.

    Args:
        scale: the world that presses.
        target: where to press, on the table of the story.
        pose: (3,) where the object truly lies on it.
        seen: (3,) where it is seen.

    Returns:
        The weighing, on the table of the story, None where the object did not tilt; and how the
        press went.
    """
    # The edge's frame: its origin at the edge's point, x along its outward normal.
    X_WE = np.array([*target.edge_point, target.edge_angle])
    X_EW = invert(X_WE)
    place = compose(X_EW, np.array([*target.place, 0.0]))[:2]
    # The line of Drake's edge is endless: the press comes to its middle.
    shift = np.array([0.0, -place[1], 0.0])
    moved = PressTarget(
        place=(float(place[0]), 0.0),
        edge_point=TABLE_EDGE.point,
        edge_angle=TABLE_EDGE.angle,
        top=target.top,
        tip_radius=target.tip_radius,
        no_tip_force=target.no_tip_force,
    )
    scale.put(compose(X_EW, pose) + shift)
    made = scale.press(moved)
    X_ES = compose(X_EW, seen) + shift
    press = made.state.make_weighing(made.target, scale.options, X_ES)
    if press is None:
        return None, made
    # Back to the story's table: only places and directions change.
    back = compose(X_WE, np.array([*(press.place - shift[:2]), 0.0]))[:2]
    edge = compose(X_WE, np.array([*(press.edge_point - shift[:2]), 0.0]))[:2]
    planned = replace(press, pose=seen, place=back, edge_point=edge, edge_angle=target.edge_angle)
    return planned, made
