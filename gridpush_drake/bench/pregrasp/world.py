"""The worlds of the pre-grasp benchmark: a hidden object on a table with an edge.

The truth is the quasi-static LCP with loads that follow what still lies on the table, or a rigid
body in MuJoCo that stands as the model does not suppose; poses are seen with noise. The loop is
`planning.pregrasp.pregrasp_loop`.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.bench.protocol import ANGLE_STD, POSITION_STD
from gridpush_drake.bench.truth.mujoco_world import BODY_HEIGHT, TruthBody, TruthWorld
from gridpush_drake.bench.truth.sets import make_body
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import calc_loads
from gridpush_drake.errors import ObjectError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.trial import ContactOptions
from gridpush_drake.planning.pregrasp.goals import calc_overhangs
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.planning.pregrasp.pregrasp_loop import (
    Infer,
    PreGraspLoop,
    PreGraspLoopOptions,
    PreGraspMode,
    PreGraspState,
)
from gridpush_drake.planning.pregrasp.slides import simulate_near_edge
from gridpush_drake.planning.pregrasp.uncertainty import UncertainModel
from gridpush_drake.planning.simulated_world import Learn, Learner, SimulatedWorld, run_loop
from gridpush_drake.planning.support_surface import SupportSurface, find_supported
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

LEARNER = Learner(memory=14)
"""The default method, from the latest pushes: the cost of learning grows with them, and what they
tell hardly does."""

FALLEN = np.radians(10)
"""Tilt from which a body counts as dropped."""

REST_TIME = 0.5
"""s that a body in MuJoCo is given to come to rest after a push, or to tip."""

PUSH_HEIGHTS = (BODY_HEIGHT / 2, BODY_HEIGHT / 4)
"""m above the table, of the finger: the second where, pushed at the first, no three feet would bear
a body."""

TIME_STEP = 5e-4
"""s of MuJoCo: the poses of bodies that stay on the table are within 0.1 mm of those of half the
step."""

ONE_OBSERVATION = PreGraspLoopOptions(observations=1)
"""Nothing moves between two pushes: the object is decided on as it is first seen."""


class EdgeWorld(SimulatedWorld):
    """A hidden object on a table, whose support presses as much as what lies on it bears; seen anew at every look."""

    surface: SupportSurface

    def __init__(
        self, obj: GridObject, hidden: CellParameters, surface: SupportSurface, pose: ArrayLike,
        rng: np.random.Generator,
    ) -> None:  # fmt: skip
        """Puts the object down at a pose (3,); `rng` draws the noise."""
        super().__init__(
            obj,
            hidden,
            pose,
            surface,
            position_std=POSITION_STD,
            angle_std=ANGLE_STD,
            seed=rng,
            observations=1,
        )

    @property
    def pose(self) -> Array | None:
        """(3,) q_W as it is seen now; None once the object has fallen."""
        # since the last push somebody may have moved it, which says nothing of its masses
        self._seen = self.observe()
        return None if self.fallen else self._seen

    def execute(self, push: Push) -> ObservedPush:
        """Pushes; what is seen is noisy, and says whether a part of the object hung over the edge."""
        self._on_table = True
        seen = super().execute(push)
        return replace(seen, overhang=not self._on_table)

    def _move(self, push: Push, times: Array) -> tuple[Array, bool]:
        motion = simulate_near_edge(self.obj, self.hidden, push, self.true_pose, self.surface)
        self._on_table = bool(find_supported(self.obj, motion.poses, self.surface).all())
        return motion.poses, motion.fell

    def hangs_safely(self) -> bool:
        """Whether the object, as it lies, stays on the table."""
        return calc_loads(self.obj, self.hidden, self.true_pose, self.surface.corners) is not None


class MujocoWorld(EdgeWorld):
    """A rigid body in MuJoCo on a rectangular table. It is dropped where it tilts by FALLEN or more."""

    def __init__(
        self, obj: GridObject, hidden: CellParameters, size: tuple[float, float], pose: ArrayLike,
        rng: np.random.Generator, support: str,
    ) -> None:  # fmt: skip
        """Puts the body down.

        Args:
            obj: the object.
            hidden: its true masses, up to a common scale, and frictions.
            size: of the table about the world's origin, m.
            pose: (3,) m and rad.
            rng: draws the feet's places and the noise.
            support: how it stands, of `truth.sets.KINDS`.

        The height at which it is pushed is known: `obj` has it.

        Raises:
            GridPushError: MuJoCo is not installed.
            ObjectError: no three feet are found that it stands on.
        """
        x, y = size[0] / 2, size[1] / 2
        light = replace(hidden, mass=hidden.mass / hidden.total_mass)
        body = replace(_stand(support, obj, light, rng).harden(), time_step=TIME_STEP)
        known, told = (
            know_height(obj, body.push_height),
            replace(light, push_height=body.push_height),
        )
        self._truth = TruthWorld(body, ContactOptions().radius, (-x, -y, x, y))
        self._truth.put(pose)
        super().__init__(known, told, SupportSurface.rectangle((0.0, 0.0), size), pose, rng)

    def _move(self, push: Push, times: Array) -> tuple[Array, bool]:
        motion = self._truth.push(push)
        self._truth.wait(REST_TIME)
        poses = np.column_stack(
            [np.interp(times, motion.times, column) for column in motion.poses.T]
        )
        fell = bool(self._truth.read_tilt() >= FALLEN)
        if (motion.tilt >= FALLEN).any():
            fallen = motion.times[np.argmax(motion.tilt >= FALLEN)]
            fell, poses = True, poses[: max(int(np.searchsorted(times, fallen)), 1)]
        elif not fell:
            poses[-1] = self._truth.read_pose()
        poses[:, 2] = np.unwrap(np.append(self.true_pose[2], poses[:, 2]))[1:]
        self._on_table = bool(find_supported(self.obj, poses, self.surface).all())
        return poses, fell

    def hangs_safely(self) -> bool:
        """Whether the object, as it lies, stays on the table."""
        self._truth.wait(REST_TIME)
        return bool(self._truth.read_tilt() < FALLEN)


def _stand(
    support: str, obj: GridObject, params: CellParameters, rng: np.random.Generator
) -> TruthBody:
    """The body, pushed at the first of PUSH_HEIGHTS at which it stands."""
    for height in PUSH_HEIGHTS[:-1]:
        try:
            return make_body(support, obj, params, rng, height)
        except ObjectError:
            continue
    return make_body(support, obj, params, rng, PUSH_HEIGHTS[-1])


def know_height(obj: GridObject, height: float) -> GridObject:
    """The object, known to be pushed at a height, m."""
    radius = obj.prior.pusher_radius or ContactOptions().radius
    return replace(obj, prior=replace(obj.prior, pusher_radius=radius, push_height=height or None))


@dataclass(frozen=True)
class Outcome:
    """How a run ended: whether a part was declared graspable, and truly hangs over with the object at rest; or fell.

    `margin` is the goal's stability margin at the worst, m; None without a goal.
    """

    grasped: bool
    dropped: bool
    pokes: int
    slides: int
    reason: str
    margin: float | None = None


def run_pregrasp(
    world: EdgeWorld,
    planner: PreGraspPlanner,
    learn: Learn | None = LEARNER,
    infer: Infer | None = None,
) -> Outcome:
    """Runs the task until a part can be grasped, or to its end.

    Args:
        world: the hidden object.
        planner: decides.
        learn: learns after every push; None never.
        infer: says what is held possible; by default what the identification's posterior says.
    """
    loop = PreGraspLoop(planner, lambda *_: None, infer=infer, options=ONE_OBSERVATION)
    state = run_loop(loop, planner.obj, world, is_over, learn=learn, surface=world.surface).state
    status = state.status
    margin = float(status.margin) if np.isfinite(status.margin) else None
    if world.fallen:
        return Outcome(False, True, status.pokes, status.slides, status.reason, margin)
    grasped = status.mode == PreGraspMode.VERIFYING and _hangs_over(world, planner)
    return Outcome(grasped, False, status.pokes, status.slides, status.reason, margin)


def is_over(state: PreGraspState) -> bool:
    """Whether a loop is done, but for the grasp."""
    return state.status.over or state.status.mode in (PreGraspMode.VERIFYING, PreGraspMode.LOST)


@dataclass(frozen=True)
class PaperLearner:
    """What the paper's method learns: masses and frictions within a range, taken for granted.

    Attributes:
        friction_range: that frictions are sought in.
        min_pokes: the first pushes, chosen, as the default method's are, by what that one learned.
    """

    friction_range: tuple[float, float]
    min_pokes: int

    def learn(
        self, obj: GridObject, log: PushLog, before: Identification | None
    ) -> Identification | None:
        """What the pushes say."""
        chosen = LEARNER.select(log)
        if len(chosen) < self.min_pokes:
            return LEARNER(obj, log, before)
        if chosen[-1] is not log[-1]:
            return before
        low, high = self.friction_range
        wide = replace(obj, prior=replace(obj.prior, friction_min=low, friction_max=high))
        return identify(wide, chosen, method="paper", regime="quasi_static")

    def make_inference(self, obj: GridObject) -> Infer:
        """What is held possible: what the posterior says of the first pokes, then the parameters as they are."""

        def infer(found: Identification | None, log: PushLog) -> UncertainModel | None:
            if found is None:
                return None
            if len(LEARNER.select(log)) < self.min_pokes:
                used = log.subset(
                    [i for i, seen in enumerate(log) if seen.name in found.push_names]
                )
                return UncertainModel.of_identification(found, log=used)
            return UncertainModel.of_parameters(obj, found.params)

        return infer


def _hangs_over(world: EdgeWorld, planner: PreGraspPlanner) -> bool:
    overhangs = calc_overhangs(planner.parts, world.true_pose, world.surface)
    return bool(overhangs.max() >= 0) and world.hangs_safely()
