"""The worlds of the pre-grasp benchmark, and how a run in one of them is made and judged.

An object with hidden masses lies on a table with an edge. What moves it is the quasi-static LCP
with loads that follow what still lies on the table (`EdgeWorld`), or a rigid body in MuJoCo that
stands as the model does not suppose (`MujocoEdgeWorld`). Poses are seen with noise. Any other
`PushWorld` will do as well. The loop is `planning.pregrasp.pregrasp_loop`.
"""

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.bench.truth.mujoco_world import BODY_HEIGHT, MujocoWorld, TruthBody
from gridpush_drake.bench.truth.sets import HALF_HEIGHT, make_body
from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.push import Push, make_path_times
from gridpush_drake.dynamics.pusher import choose_pusher_radius
from gridpush_drake.dynamics.simulation import calc_loads
from gridpush_drake.errors import ObjectError, PlanningError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.edge_motion import simulate_near_edge
from gridpush_drake.planning.loop_run import Learn, Learner, run_loop
from gridpush_drake.planning.pregrasp.goals import calc_overhangs
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.planning.pregrasp.pregrasp_loop import (
    Infer,
    PreGraspLoop,
    PreGraspLoopOptions,
    PreGraspMode,
    PreGraspState,
)
from gridpush_drake.planning.support_surface import SupportSurface, find_supported
from gridpush_drake.planning.world import (
    FALLEN_TILT,
    WORLD_REGIME,
    PushWorld,
    TrackedWorld,
    WorldMotion,
    WorldTruth,
)
from gridpush_drake.pushes.push_log import PushLog

DEFAULT_LEARNER = Learner(memory=14)
"""Default method of learning, from the latest pushes: the cost of learning grows with their number,
and what they tell hardly does."""

REST_TIME = 0.5
"""Time that a body in MuJoCo is given to come to rest after a push, or to tip, s."""

PUSH_HEIGHTS = (BODY_HEIGHT / 2, BODY_HEIGHT / 4)
"""Heights of the finger above the table, m. The second one is taken where no three feet would bear
a body that is pushed at the first."""

TIME_STEP = 5e-4
"""Time step of MuJoCo, s. Poses of bodies that stay on the table are within 0.1 mm of those of half
the step."""

ONE_OBSERVATION = PreGraspLoopOptions(observations=1)
"""Options of a loop in a world in which nothing moves between two pushes: the object is decided on
as it is first seen."""


class EdgeWorld(TrackedWorld):
    """An object on a table, moved by `simulate`, with loads that follow what lies on the table.

    The object is seen anew at every look: since the last push somebody may have moved it, which
    says nothing of its masses.

    Attributes:
        bodies: the object with its true masses and frictions.
        surface: the table.
    """

    bodies: Bodies

    def __init__(
        self,
        bodies: Bodies,
        pose: ArrayLike,
        surface: SupportSurface | None = None,
        *,
        position_std: float = 0.0,
        angle_std: float = 0.0,
        seed: int | np.random.Generator = 0,
    ) -> None:
        """Puts an object down; the arguments are those of `planning.world.WorldMaker`.

        Raises:
            PlanningError: there is no table, or a number is out of range.
        """
        self.bodies = bodies
        self.surface = require_table(surface)
        super().__init__(
            pose,
            position_std=position_std,
            angle_std=angle_std,
            seed=seed,
            observations=1,
            observes_anew=True,
        )

    def do_put(self, pose: Array) -> Array:
        """Returns the pose (3,) itself: the object has no other state."""
        return pose

    def do_push(self, push: Push, pose: Array) -> WorldMotion:
        """Simulates a push of the object from a pose (3,), up to where it falls."""
        times = make_path_times(push, WORLD_REGIME)
        motion = simulate_near_edge(self.bodies, push, pose, self.surface)
        return WorldMotion(
            times=times[: len(motion.poses)],
            poses=motion.poses,
            fell=motion.fell,
            overhang=not find_supported(self.bodies.obj, motion.poses, self.surface).all(),
        )

    @property
    def truth(self) -> WorldTruth:
        """What is true of the object now, for judges only."""
        truth = super().truth
        loads = calc_loads(self.bodies, truth.pose, self.surface.corners)
        return replace(truth, stays=loads is not None)


class MujocoEdgeWorld(MujocoWorld):
    """A rigid body in MuJoCo on a rectangular table.

    The object is seen anew at every look. It has fallen where it tilts by FALLEN_TILT or more, or
    does within REST_TIME after a push.

    Attributes:
        bodies: the object, of which is known at what height it is pushed, with its true masses, of
            a sum of 1 kg, its frictions, and that height.
        surface: the table.
    """

    def __init__(
        self,
        bodies: Bodies,
        pose: ArrayLike,
        surface: SupportSurface | None = None,
        *,
        position_std: float = 0.0,
        angle_std: float = 0.0,
        seed: int | np.random.Generator = 0,
        support: str = HALF_HEIGHT,
    ) -> None:
        """Puts a body down; the other arguments are those of `planning.world.WorldMaker`.

        Args:
            bodies: the object with its true masses, up to a common scale, and frictions.
            pose: (3,) where it lies, m and rad.
            surface: the table, a rectangle along the world's axes.
            position_std: standard deviation of seen positions, per axis, m.
            angle_std: standard deviation of seen angles, rad.
            seed: seed of the feet's places and of the noise, or the generator that draws them.
            support: how the body stands, one of `truth.sets.KINDS`.

        Raises:
            MissingExtraError: MuJoCo is not installed.
            ObjectError: no three feet are found that it stands on.
            PlanningError: the table is no rectangle along the world's axes.
        """
        self.surface = require_table(surface)
        left, low, right, high = self.surface.polygon.bounds
        if len(self.surface.corners) != RECTANGLE_CORNERS or not np.isclose(
            self.surface.polygon.area, (right - left) * (high - low)
        ):
            raise PlanningError(
                f"table: is {self.surface!r}; expected a rectangle along the world's axes"
            )
        rng = np.random.default_rng(seed)
        obj = bodies.obj
        params = bodies.params
        light = replace(params, mass=params.mass / params.total_mass)
        body = replace(_stand(support, obj, light, rng).harden(), time_step=TIME_STEP)
        super().__init__(
            body,
            choose_pusher_radius(obj),
            (left, low, right, high),
            pose,
            position_std=position_std,
            angle_std=angle_std,
            seed=rng,
            observations=1,
            observes_anew=True,
        )
        self.bodies = Bodies(
            know_height(obj, body.push_height), replace(light, push_height=body.push_height)
        )

    def do_push(self, push: Push, pose: Array) -> WorldMotion:
        """Pushes the body, and waits until it rests; the motion ends where it falls."""
        made = self._push(push)
        self._let_pass(REST_TIME)
        times = make_path_times(push, WORLD_REGIME)
        poses = np.column_stack([np.interp(times, made.times, column) for column in made.poses.T])
        assert made.tilt is not None
        tilts = made.tilt >= FALLEN_TILT
        fell = bool(self._read_tilt() >= FALLEN_TILT)
        if tilts.any():
            fell = True
            fallen = made.times[np.argmax(tilts)]
            poses = poses[: max(int(np.searchsorted(times, fallen)), 1)]
        elif not fell:
            # It may have moved on a little while it came to rest.
            poses[-1] = self._read_pose()
        poses[:, 2] = np.unwrap(np.append(pose[2], poses[:, 2]))[1:]
        return WorldMotion(
            times=times[: len(poses)],
            poses=poses,
            fell=fell,
            tilt=np.interp(times[: len(poses)], made.times, made.tilt),
            overhang=not find_supported(self.bodies.obj, poses, self.surface).all(),
        )

    @property
    def truth(self) -> WorldTruth:
        """What is true of the body now, for judges only; it stays if it does for REST_TIME."""
        return replace(super().truth, stays=self._would_stay())

    def _would_stay(self) -> bool:
        """Says whether the body stands after another REST_TIME; that time passes in a copy."""
        kept = (self._datas, self._scene, self._steps)
        self._datas = [copy(data) for data in self._datas]
        self._let_pass(REST_TIME)
        stays = self._read_tilt() < FALLEN_TILT
        self._datas, self._scene, self._steps = kept
        return stays


RECTANGLE_CORNERS = 4
"""Number of corners of a rectangle."""


def require_table(surface: SupportSurface | None) -> SupportSurface:
    """Returns a table. Raises PlanningError where there is none."""
    if surface is None:
        raise PlanningError("table: is missing; expected one, whose edge objects are slid to")
    return surface


def _stand(
    support: str, obj: GridObject, params: CellParameters, rng: np.random.Generator
) -> TruthBody:
    """Makes the body, pushed at the first of PUSH_HEIGHTS at which it stands."""
    for height in PUSH_HEIGHTS[:-1]:
        try:
            return make_body(support, obj, params, rng, height)
        except ObjectError:
            continue
    return make_body(support, obj, params, rng, PUSH_HEIGHTS[-1])


def know_height(obj: GridObject, height: float) -> GridObject:
    """Returns the object, known to be pushed at a height, m, by the finger of the planners."""
    radius = choose_pusher_radius(obj)
    return replace(obj, prior=replace(obj.prior, pusher_radius=radius, push_height=height or None))


@dataclass(frozen=True)
class PreGraspOutcome:
    """How a run ended.

    Attributes:
        grasped: whether a part was declared graspable, truly hangs over the edge, and the object is
            at rest.
        dropped: whether the object fell.
        pokes: number of pushes that were made to learn only.
        slides: number of pushes towards the edge.
        reason: the end in a sentence.
        margin: stability margin of the goal at the worst, m; None without a goal.
    """

    grasped: bool
    dropped: bool
    pokes: int
    slides: int
    reason: str
    margin: float | None = None


def run_pregrasp(
    world: PushWorld,
    planner: PreGraspPlanner,
    learn: Learn | None = DEFAULT_LEARNER,
    infer: Infer | None = None,
) -> PreGraspOutcome:
    """Runs the task until a part can be grasped, or to its end.

    Args:
        world: the hidden object.
        planner: decides, and knows the table.
        learn: learns after every push; None never learns.
        infer: says what is held possible; by default what the identification's posterior says.
    """
    loop = PreGraspLoop(planner, lambda *_: None, infer=infer, options=ONE_OBSERVATION)
    run = run_loop(loop, world, is_over, obj=planner.obj, learn=learn, surface=planner.surface)
    status = run.state.status
    truth = world.truth
    grasped = False
    if status.mode == PreGraspMode.VERIFYING and not truth.fallen:
        overhangs = calc_overhangs(planner.parts, truth.pose, planner.surface)
        grasped = bool(overhangs.max() >= 0) and truth.stays
    return PreGraspOutcome(
        grasped=grasped,
        dropped=bool(truth.fallen),
        pokes=status.pokes,
        slides=status.slides,
        reason=status.reason,
        margin=float(status.margin) if np.isfinite(status.margin) else None,
    )


def is_over(state: PreGraspState) -> bool:
    """Says whether a loop is done, but for the grasp."""
    return state.status.over or state.status.mode in (PreGraspMode.VERIFYING, PreGraspMode.LOST)


@dataclass(frozen=True)
class PaperLearner:
    """Learns as the paper does: masses and frictions within a range, which are taken for granted.

    Attributes:
        friction_range: least and greatest friction that is sought.
        min_pokes: number of pokes before the paper's method learns. These first ones are chosen, as
            those of the default method are, by what that method learned.
    """

    friction_range: tuple[float, float]
    min_pokes: int

    def learn(
        self, obj: GridObject, log: PushLog, before: Identification | None
    ) -> Identification | None:
        """Learns from the latest pushes."""
        chosen = DEFAULT_LEARNER.select(log)
        if len(chosen) < self.min_pokes:
            return DEFAULT_LEARNER(obj, log, before)
        if chosen[-1] is not log[-1]:
            return before
        low, high = self.friction_range
        wide = replace(obj, prior=replace(obj.prior, friction_min=low, friction_max=high))
        return identify(Model(wide), chosen, method="paper", regime="quasi_static")

    def make_inference(self, obj: GridObject) -> Infer:
        """Makes what says what is held possible.

        At first that is what the posterior says of the pokes, and then the parameters as they are.
        """

        def infer(found: Identification | None, log: PushLog) -> Belief | None:
            if found is None:
                return None
            if len(DEFAULT_LEARNER.select(log)) < self.min_pokes:
                names = found.push_names
                used = log.subset([i for i, seen in enumerate(log) if seen.name in names])
                return Belief.of_identification(found, log=used)
            return Belief.of_parameters(Model(obj, found.params))

        return infer
