"""`gridpush bench weighing`: mass, center of mass and friction of objects of which nothing is told.

Each object gets a hidden mass of 0.1 to 3 kg, masses of its parts, and a friction of each part. It
is pushed five to twelve times, until the forces that the finger feels tell its friction, in the
model's own simulator. Then it is laid over the table's edge in Drake and pressed, as
the robot's planner decides (`planning.pregrasp.weighing_planner`), until it is known. Poses, forces
and places are told with noise. What is not simulated is how it gets from one place at the edge to
the next: where the planner would slide it there, it is put there.

With `--bottom` the object is a rigid body in MuJoCo instead, on feet with a gap below its
underside, which is drawn, or with a flat bottom (`bench.tilt_tests.mujoco_scale`). Its feet bear it
where it is pushed, too.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal
from zlib import crc32

import numpy as np

from gridpush_drake.bench.study import OBJECTS_OPTION, Done, JobKind, Study, StudyOptions, option
from gridpush_drake.bench.tilt_tests.mujoco_scale import MujocoScale
from gridpush_drake.bench.tilt_tests.whole_task import make_table, tell_story
from gridpush_drake.bench.tilt_tests.world import (
    TABLE_EDGE,
    TiltTestNoise,
    TiltTestRun,
    TiltTestWorld,
)
from gridpush_drake.bench.truth.sets import (
    FLAT_KIND,
    OWN_WEIGHT,
    THREE_FEET,
    VERTICES_KIND,
    make_body,
)
from gridpush_drake.dynamics.push import Push, make_path_times
from gridpush_drake.dynamics.pusher import choose_pusher_radius
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import GridPushError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.absolute.errors import compare_with_truth
from gridpush_drake.identification.absolute.estimate import TiltingLine
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import Identification
from gridpush_drake.identification.tilt_tests.weighed_model import estimate_masses
from gridpush_drake.multibody.ground_truth import calc_rigid_loads, sample_ground_truth
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import (
    UNKNOWN_FRICTION,
    find_shipped_object,
    list_shipped_objects,
)
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.pregrasp.decision import PreGraspOptions
from gridpush_drake.planning.pregrasp.grasp.grasp_parts import find_grasp_parts
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.planning.pregrasp.pregrasp_loop import PreGraspLoopOptions
from gridpush_drake.planning.pregrasp.weighing_planner import TiltTestPlanner
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.weighing.plan import Edge, PlannedPress
from gridpush_drake.planning.weighing.press import PressOutcome, has_slid
from gridpush_drake.planning.world import FALLEN_TILT
from gridpush_drake.pushes.push_log import ObservedPush, PushLog
from gridpush_drake.pushes.weighings import MassTestLog
from gridpush_drake.report.table import Mean, Table, by_object, calc_mean, mean_of
from gridpush_drake.units import DEG_PER_RAD, MM_PER_M

SCALE_PART = "scale"
"""Name of the part that weighs an object in one place at the edge after another."""

AT_EDGE = "edge"
"""Name of the part that weighs an object on the way to where it can be grasped."""

MAX_ARM = 0.1
"""Farthest that a narrow part may be from where the center of mass is estimated, m."""

DEFAULT_TRUTH_COUNT = 10
"""Number of hidden truths of each object by default."""

MASS_RANGE = (0.1, 3.0)
"""Least and greatest mass of an object, kg; drawn evenly in its logarithm."""

FRICTION_RANGE = UNKNOWN_FRICTION
"""Least and greatest friction coefficient of a part, and what a plan takes for possible."""

CHECKED_PUSH_COUNTS = (5, 8, 12)
"""Numbers of pushes after which it is looked how well they tell the friction."""

ENOUGH_FORCE = 0.03
"""Relative standard deviation of the whole friction, as forces tell it, that is enough."""

PUSH_LENGTH = 0.06
"""Length of a push, m."""

PUSH_SPEED = 0.03
"""Speed of a push, m/s."""

MAX_PUSH_ANGLE = 0.5
"""Greatest angle of a push from the outline's inward normal, rad."""

OBSERVED_POSE_COUNT = 6
"""Number of poses that are seen during a push, after the first."""

FORCE_PERIOD = 0.02
"""Time between two samples of the force of a push, s."""

SETTLING_TIME = 0.2
"""Time that an object has to come to rest at the edge, s."""

SCALE_TABLE = SupportSurface.rectangle((-0.5, 0.0), (1.0, 1.0))
"""Table by which presses are planned; its edge x = 0 is that of the scale."""

MAX_FAILED_PRESSES = PreGraspLoopOptions().max_failed_presses
"""Number of presses in a row that weighed nothing after which an object is given up."""

PAD_FORCE = 80.0
"""Force with which the gripper presses on an object, N, by which the planner finds what to grasp:
also objects that are narrow nowhere are weighed."""

BOTTOM_KINDS = (OWN_WEIGHT, FLAT_KIND, THREE_FEET, VERTICES_KIND)
"""On what an object may stand: each cell bears its own weight, in Drake; or a rigid body in MuJoCo,
see `bench.truth.sets`."""

RIM_GAPS = (2e-5, 1e-3)
"""Least and greatest height of an underside above the table, m; drawn evenly in its logarithm."""

UNLOADED_FRACTION = 1e-3
"""Fraction of the weight that cells without feet bear together where they are pushed. The model
takes no cell without mass."""

ROUGH_MASS_GOAL = 0.05
"""Relative error of the mass that is hoped for where a bottom is not flat."""

ROUGH_CENTER_GOAL = 0.005
"""Error of the center of mass that is hoped for there, m."""

MASS_GOAL = 0.03
"""Relative error of the mass that is hoped for."""

CENTER_GOAL = 0.003
"""Error of the center of mass that is hoped for, m."""

FRICTION_GOAL = 0.03
"""Error of the mean friction coefficient that is hoped for."""

Column = Callable[[Any], str | float | int | Mean | None]
"""What stands in a column of some scores."""


@dataclass(frozen=True)
class TiltTestJob:
    """The weighing of one object with one hidden truth.

    Attributes:
        name: name of a shipped object.
        seed: seed of truth and noise.
        bottom: one of BOTTOM_KINDS.
    """

    name: str
    seed: int
    bottom: str = OWN_WEIGHT


@dataclass(frozen=True)
class EdgeJob:
    """One object with one hidden truth, slid to where it can be grasped.

    Attributes:
        name: name of a shipped object.
        seed: seed of truth, start and noise.
    """

    name: str
    seed: int


@dataclass(frozen=True)
class EdgeScore:
    """How an object got to where it can be grasped, with one planner.

    Attributes:
        name: name of the object.
        seed: seed of truth, start and noise.
        weighs: whether the planner weighs where it would give up.
        grasped: whether it truly can be grasped.
        dropped: whether it fell.
        pokes: number of pokes.
        slides: number of slides.
        presses: number of presses.
        max_tilt: greatest tilt in a press, rad.
        reason: the end in a sentence.
    """

    name: str
    seed: int
    weighs: bool
    grasped: bool
    dropped: bool
    pokes: int
    slides: int
    presses: int
    max_tilt: float
    reason: str


@dataclass(frozen=True)
class TiltTestScore:
    """What came of it.

    Attributes:
        name: name of the object.
        seed: seed of truth and noise.
        mass: true mass, kg.
        pushes: number of pushes.
        presses: number of presses.
        no_tilt_count: number of them at which the object did not tilt up to the greatest force.
        time: how long all pushes and presses took, s.
        mass_error: error of the mass, relative to it; None where nothing could be weighed.
        center_error: distance of the center of mass from where it is estimated, m.
        friction_error: error of the mean friction coefficient; None where nothing could be weighed.
        mass_holds: whether the 95 % interval of the mass holds it.
        center_holds: whether the 95 % region of the center of mass holds it.
        friction_holds: whether the 95 % interval of the mean friction holds it.
        max_tilt: greatest true tilt, rad.
        moved: greatest distance that a press left the object from where it lay, m.
        fell: whether it fell off the table.
        bottom: one of BOTTOM_KINDS.
        rim_gap: height of the underside above the table, m.
        rocked: number of presses in which it rocked before it tilted about the edge.
        left_out: number of presses that do not count as tilts about the edge.
        contradictory: whether the observations contradict each other, so that nothing is stated.
        slides: how often it was laid elsewhere to be pressed.
    """

    name: str
    seed: int
    mass: float
    pushes: int
    presses: int
    no_tilt_count: int
    time: float
    mass_error: float | None
    center_error: float
    friction_error: float | None
    mass_holds: bool
    center_holds: bool
    friction_holds: bool
    max_tilt: float
    moved: float
    fell: bool
    bottom: str = OWN_WEIGHT
    rim_gap: float = 0.0
    rocked: int = 0
    left_out: int = 0
    contradictory: bool = False
    slides: int = 0


@dataclass(frozen=True)
class TiltTestBenchOptions(StudyOptions):
    """What is measured.

    Attributes:
        objects: names of shipped objects; all by default.
        truths: number of hidden truths of each object; the first one has the seed `seed`.
        part: which part is measured.
        bottom: on what objects stand that are weighed in one place after another.
    """

    objects: tuple[str, ...] | None = option(None, **OBJECTS_OPTION)
    truths: int = option(DEFAULT_TRUTH_COUNT, "Hidden truths of each object.", least=1)
    part: Literal["all", "scale", "edge"] = option(
        "all",
        "Which part to measure: scale weighs an object in one place at the edge after another; "
        "edge weighs it on the way to where it can be grasped.",
    )
    bottom: Literal["own_weight", "flat", "three_feet", "vertices"] = option(
        "own_weight",
        "On what objects of the part scale stand. own_weight: each cell bears its own weight, in "
        "Drake; flat, three_feet, vertices: rigid bodies in MuJoCo, with gaps below their "
        "undersides of 0.02 to 1 mm where they are not flat.",
        metavar="BOTTOM",
    )

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the objects."""
        return tuple(list_shipped_objects()) if self.objects is None else self.objects


def shorten(options: TiltTestBenchOptions) -> TiltTestBenchOptions:
    """Makes the options of the quick variant: one truth of the first object."""
    return replace(options, objects=options.names[:1], truths=1)


def make_jobs(options: TiltTestBenchOptions) -> list[TiltTestJob | EdgeJob]:
    """Makes a job for each object and truth.

    To where it can be grasped an object is slid only if it has a graspable part.

    Raises:
        ObjectError: an object is not shipped.
        GridPushError: there is no object, or no truth; or objects are to be slid to the edge alone,
            and none has a graspable part.
    """
    if not options.names:
        raise GridPushError("objects: none; expected at least one")
    if options.truths < 1:
        raise GridPushError("truths: none; expected at least one")
    for name in options.names:
        find_shipped_object(name)
    seeds = range(options.seed, options.seed + options.truths)
    names = {SCALE_PART: options.names}
    if options.part != SCALE_PART:
        names[AT_EDGE] = tuple(name for name in options.names if _has_graspable_part(name))
        if options.part == AT_EDGE and not names[AT_EDGE]:
            raise GridPushError(
                f"objects: {', '.join(options.names)} cannot be grasped; expected at least one "
                "with a part that is narrower than the gripper opens"
            )
    kinds: dict[str, type[TiltTestJob] | type[EdgeJob]] = {
        SCALE_PART: TiltTestJob,
        AT_EDGE: EdgeJob,
    }
    jobs = [
        kind(name, seed)
        for part, kind in kinds.items()
        if options.part in ("all", part)
        for name in names[part]
        for seed in seeds
    ]
    return [
        replace(job, bottom=options.bottom) if isinstance(job, TiltTestJob) else job for job in jobs
    ]


def _has_graspable_part(name: str) -> bool:
    """Whether a shipped object has a part that the gripper takes."""
    obj = GridObject.from_yaml(find_shipped_object(name)).forget()
    return bool(find_grasp_parts(obj, PreGraspOptions().gripper))


@dataclass(frozen=True, eq=False)
class Weighed:
    """An object that is to be weighed.

    Attributes:
        obj: the object, of which nothing but the outline is told.
        truth: its true masses and frictions. Where it stands on feet, all cells have the mean
            friction of the feet, by what these bear.
        pushed: masses and frictions with which it moves when it is pushed: what its feet bear.
        scale: the world in which it is pressed.
        rim_gap: height of its underside above the table, m.
    """

    obj: GridObject
    truth: CellParameters
    pushed: CellParameters
    scale: TiltTestWorld | MujocoScale
    rim_gap: float = 0.0


def make_weighed(job: TiltTestJob) -> Weighed:
    """Makes the object of a job, and the world in which it is pressed."""
    obj = GridObject.from_yaml(find_shipped_object(job.name)).forget()
    truth = draw_truth(obj, job.seed)
    if job.bottom == OWN_WEIGHT:
        return Weighed(obj, truth, truth, TiltTestWorld(obj, truth, seed=job.seed))
    rng = np.random.default_rng((job.seed, 16, crc32(obj.name.encode())))
    rim_gap = float(np.exp(rng.uniform(*np.log(RIM_GAPS))))
    body = make_body(job.bottom, obj, truth, rng, 0.0, rim_gap)
    fractions = calc_rigid_loads(body.feet, body.gap, truth.center_of_mass(obj))
    loads = np.bincount(body.cell, fractions, obj.n).astype(np.float64) + UNLOADED_FRACTION / obj.n
    loads *= truth.total_mass / loads.sum()
    mean = float(loads @ truth.friction) / truth.total_mass
    return Weighed(
        obj=obj,
        truth=replace(truth, friction=np.full(obj.n, mean)),
        pushed=replace(truth, mass=loads),
        scale=MujocoScale(body, seed=job.seed),
        rim_gap=body.bottom,
    )


def run_job(job: TiltTestJob) -> TiltTestScore:
    """Pushes and weighs one object."""
    made = make_weighed(job)
    found, pushes = push_and_learn(made.obj, made.pushed, job.seed)
    known, course = weigh_at_edge(made, found, pushes, job.seed)
    return score(job, known, made.truth, course, made.rim_gap)


def make_planner(obj: GridObject, top: float) -> TiltTestPlanner:
    """Makes the planner that a robot runs, on the table of the scale.

    Args:
        obj: the object.
        top: height of its top above the table, m.
    """
    planner = TiltTestPlanner(obj, SCALE_TABLE, PreGraspOptions(pad_force=PAD_FORCE))
    planner.weighing = replace(planner.weighing, top=top)
    return planner


def weigh_at_edge(
    made: Weighed, found: Identification, pushes: PushLog, seed: int
) -> tuple[Identification, "PressCourse"]:
    """Weighs an object at the edge, as the robot's planner decides, until it is known well.

    Where the planner would slide the object to be pressed, it is laid there.

    Args:
        made: the object, and the world in which it is pressed.
        found: what was learned from pushes.
        pushes: the pushes.
        seed: of what is learned.

    Returns:
        What is known in the end, and how the presses went.
    """
    planner = make_planner(made.obj, made.scale.height)
    world = made.scale
    log = MassTestLog()
    known = found
    model = make_model(known, pushes)
    course = PressCourse(time=len(found.push_names) * PUSH_LENGTH / PUSH_SPEED)
    seen = np.array([*SCALE_TABLE.polygon.centroid.coords[0], 0.0])
    while planner.may_weigh(model, len(found.push_names), course.slides):
        # As the robot does, it supposes a heavier object after each press that this one withstood,
        # and does not press again where it slid.
        supposing = planner
        for _ in range(course.no_tilts_in_a_row):
            supposing = supposing.suppose_heavier()
        supposing = supposing.avoid(course.slid_places)
        may_slide = course.slides < supposing.calc_slide_limit(model.presses)
        choice = next(supposing.plan_presses(seen, model, may_slide), None)
        if choice is None or course.failed_in_a_row >= MAX_FAILED_PRESSES:
            break
        if choice.placements:
            world.put(lay_at_edge(choice.placements[0].planned))
            world.let_pass(SETTLING_TIME)
            seen = world.observe()
            course = replace(course, slides=course.slides + 1)
            continue
        assert choice.here is not None
        press = world.press(choice.here.target)
        world.let_pass(SETTLING_TIME)
        weighing = press.state.make_weighing(press.target, world.options, seen)
        before = seen
        seen = world.observe()
        # What was shifted by the press tells nothing of the weight.
        if has_slid(before, seen):
            weighing = None
            slid = choice.here.target.find_on(before)
            course = replace(course, slid_places=(*course.slid_places, slid))
        course = course.note(press, weighing is not None)
        if press.max_tilt >= FALLEN_TILT:
            break
        if weighing is not None:
            log = replace(log, presses=(*log.presses, weighing))
            known = estimate_masses(found, log, seed=seed)
            model = make_model(known, pushes)
    return known, course


def make_model(known: Identification, pushes: PushLog) -> Belief:
    """Makes the model by which presses are planned, with any friction taken for possible."""
    return Belief.of_identification(known, friction_range=FRICTION_RANGE, log=pushes)


def lay_at_edge(planned: PlannedPress) -> Array:
    """Makes the pose (3,) at the scale's edge of an object that is to be pressed at any edge."""
    target = planned.target
    edge = Edge(target.edge_point, target.edge_angle)
    # The scale's edge bears about its middle.
    along = float(edge.calc_along(planned.pose[:2]))
    return planned.move_to(TABLE_EDGE, -along).pose


@dataclass(frozen=True)
class PressCourse:
    """How the presses of an object went.

    Attributes:
        slides: how often the object was laid elsewhere to be pressed.
        presses: number of presses.
        no_tilt_count: number of them at which the object did not tilt up to the greatest force.
        no_tilts_in_a_row: number of those since the last press that weighed something.
        failed_in_a_row: number of presses since then.
        slid_places: where on the object it was pressed and slid, body frame, m.
        time: how long all pushes and presses took, s.
        max_tilt: greatest true tilt, rad.
        moved: greatest distance that a press left the object from where it lay, m.
    """

    slides: int = 0
    presses: int = 0
    no_tilt_count: int = 0
    no_tilts_in_a_row: int = 0
    failed_in_a_row: int = 0
    slid_places: tuple[tuple[float, float], ...] = ()
    time: float = 0.0
    max_tilt: float = 0.0
    moved: float = 0.0

    def note(self, press: TiltTestRun, weighs: bool) -> "PressCourse":
        """Adds a press.

        Args:
            press: how it went.
            weighs: whether it told something of the weight.
        """
        too_heavy = press.state.outcome == PressOutcome.TOO_HEAVY
        return replace(
            self,
            presses=self.presses + 1,
            no_tilt_count=self.no_tilt_count + too_heavy,
            no_tilts_in_a_row=0 if weighs else self.no_tilts_in_a_row + too_heavy,
            failed_in_a_row=0 if weighs else self.failed_in_a_row + 1,
            time=self.time + press.time,
            max_tilt=max(self.max_tilt, press.max_tilt),
            moved=max(self.moved, press.moved),
        )


def score(
    job: TiltTestJob,
    known: Identification,
    truth: CellParameters,
    course: PressCourse,
    rim_gap: float = 0.0,
) -> TiltTestScore:
    """Compares what is known with the truth."""
    if known.weighed is None:
        # Nothing could be weighed, or nothing is stated of it.
        off = known.params.center_of_mass(known.obj) - truth.center_of_mass(known.obj)
        found: dict[str, Any] = {
            "mass_error": None,
            "center_error": float(np.linalg.norm(off)),
            "friction_error": None,
            "mass_holds": False,
            "center_holds": False,
            "friction_holds": False,
        }
    else:
        errors = compare_with_truth(known.weighed, known.obj, truth)
        found = {
            "mass_error": errors.mass,
            "center_error": errors.center,
            "friction_error": errors.friction,
            "mass_holds": errors.mass_holds,
            "center_holds": errors.center_holds,
            "friction_holds": errors.friction_holds,
        }
    tests = () if known.absolute is None else known.absolute.tests
    return TiltTestScore(
        name=job.name,
        seed=job.seed,
        mass=float(truth.total_mass),
        pushes=len(known.push_names),
        slides=course.slides,
        presses=course.presses,
        no_tilt_count=course.no_tilt_count,
        time=course.time,
        max_tilt=float(course.max_tilt),
        moved=course.moved,
        fell=bool(course.max_tilt >= FALLEN_TILT),
        bottom=job.bottom,
        rim_gap=rim_gap,
        rocked=sum(one.support_distance is not None for one in tests),
        left_out=sum(one.line != TiltingLine.EDGE for one in tests),
        contradictory=known.absolute is not None and known.absolute.contradictory,
        **found,
    )


def draw_truth(obj: GridObject, seed: int) -> CellParameters:
    """Draws the hidden masses and frictions."""
    drawn = sample_ground_truth(obj, seed, friction_range=FRICTION_RANGE, friction_by_part=True)
    rng = np.random.default_rng((seed, 12, crc32(obj.name.encode())))
    mass = float(np.exp(rng.uniform(*np.log(MASS_RANGE))))
    return replace(drawn, mass=drawn.mass * (mass / drawn.total_mass))


def push_and_learn(
    obj: GridObject, truth: CellParameters, seed: int
) -> tuple[Identification, PushLog]:
    """Pushes an object until forces tell its friction well enough, and learns from all pushes."""
    pushes = make_pushes(obj, truth, seed, CHECKED_PUSH_COUNTS[-1])
    for count in CHECKED_PUSH_COUNTS:
        found = identify(Model(obj), pushes[:count], seed=seed)
        if found.force is not None and found.force.relative_std <= ENOUGH_FORCE:
            break
    return found, pushes[:count]


def make_pushes(obj: GridObject, truth: CellParameters, seed: int, count: int) -> PushLog:
    """Makes pushes from random places of the outline inwards, with measured forces."""
    rng = np.random.default_rng((seed, 13, crc32(obj.name.encode())))
    noise = TiltTestNoise()
    radius = choose_pusher_radius(obj)
    pushes: list[ObservedPush] = []
    while len(pushes) < count:
        place = rng.uniform(0, obj.edges.perimeter)
        angle = rng.uniform(-MAX_PUSH_ANGLE, MAX_PUSH_ANGLE)
        push = Push.on_outline(obj, place, angle, PUSH_LENGTH, radius=radius, speed=PUSH_SPEED)
        times = make_path_times(push, "quasi_static")
        motion = simulate(Model(obj, truth), push, times=times, regime="quasi_static")
        force = motion.contact_forces.sum(axis=1)
        if not force.any():
            continue
        std = np.array([noise.position, noise.position, noise.angle])
        rows = np.rint(np.linspace(0, len(times) - 1, OBSERVED_POSE_COUNT + 1)).astype(int)
        seen = motion.poses[rows] + std * rng.standard_normal((len(rows), 3))
        force_t = np.arange(0.0, push.duration, FORCE_PERIOD)
        steps = np.searchsorted(times, force_t, side="right") - 1
        felt = force[steps] + noise.force * rng.standard_normal((len(steps), 2))
        pushes.append(
            ObservedPush(
                name=f"push_{len(pushes) + 1}",
                push=push,
                pose=seen[0],
                t_observed=times[rows[1:]],
                poses_observed=seen[1:],
                force_t=force_t,
                force=felt,
            )
        )
    return PushLog(tuple(pushes))


def run_edge_job(job: EdgeJob) -> list[EdgeScore]:
    """Brings one object to where it can be grasped, with and without weighing."""
    obj = GridObject.from_yaml(find_shipped_object(job.name)).forget()
    truth = draw_truth(obj, job.seed)
    options = PreGraspOptions(max_arm=MAX_ARM)
    scores = []
    for kind in (PreGraspPlanner, TiltTestPlanner):
        story = tell_story(obj, truth, kind(obj, make_table(), options), job.seed)
        scores.append(
            EdgeScore(
                name=job.name,
                seed=job.seed,
                weighs=kind is TiltTestPlanner,
                grasped=story.grasped,
                dropped=story.dropped,
                pokes=story.pokes,
                slides=story.slides,
                presses=story.presses,
                max_tilt=story.max_tilt,
                reason=story.reason,
            )
        )
    return scores


def tabulate(options: TiltTestBenchOptions, done: Done) -> list[Table]:
    """Tabulates the scores of all parts that were measured."""
    tables = []
    scores = done.of(TILT_TEST_JOBS)
    if scores:
        tables += tabulate_scores(scores, options.names)
    stories = [score for scores in done.of(EDGE_TASK) for score in scores]
    if stories:
        tables.append(tabulate_stories(stories))
    return tables


def tabulate_stories(stories: Sequence[EdgeScore]) -> Table:
    """Makes a row for each planner."""
    rows = [
        ((name,), [one for one in stories if one.weighs == weighs])
        for name, weighs in (("gives up", False), ("weighs instead", True))
    ]
    columns: dict[str, Column] = {
        "runs": len,
        "graspable": lambda some: sum(one.grasped for one in some),
        "dropped": lambda some: sum(one.dropped for one in some),
        "pokes": mean_of("pokes"),
        "slides": mean_of("slides"),
        "presses": mean_of("presses"),
        "tilt, °": lambda some: DEG_PER_RAD * max(one.max_tilt for one in some),
    }
    notes = [
        f"Hidden as above: mass {MASS_RANGE[0]:g} to {MASS_RANGE[1]:g} kg, friction of each part "
        f"{FRICTION_RANGE[0]:g} to {FRICTION_RANGE[1]:g}; the planners take any friction between "
        "for possible.",
        "Pushes in the quasi-static model with loads that follow the table's edge, presses in "
        "Drake. graspable: a narrow part truly hangs over, and the object is at rest.",
    ]
    notes += [
        f"{one.name}, truth {one.seed}, weighs instead: {one.reason}"
        for one in stories
        if one.weighs and not one.grasped
    ]
    title = "To the table's edge, with nothing told"
    return Table.of(title, ("planner",), rows, columns, notes)


def tabulate_scores(scores: Sequence[TiltTestScore], names: Sequence[str]) -> list[Table]:
    """Tabulates how objects were weighed and how well: a row for each object, and one of all."""

    def list_errors(some: Sequence[TiltTestScore], key: str) -> list[float]:
        """Lists magnitudes of the errors of those that could be weighed."""
        return [abs(getattr(one, key)) for one in some if getattr(one, key) is not None]

    def fraction(key: str, goal: float) -> Column:
        """Makes the column of how many errors are within a goal."""
        return lambda some: int(sum(error <= goal for error in list_errors(some, key)))

    def count(key: str) -> Column:
        """Makes the column of how many something is true of."""
        return lambda some: int(sum(getattr(one, key) for one in some))

    def median(key: str, scale: float) -> Column:
        """Makes the column of the median of the errors' magnitudes."""
        return lambda some: scale * float(np.median(list_errors(some, key) or np.nan))

    work: dict[str, Column] = {
        "runs": len,
        "pushes": mean_of("pushes"),
        "slides": mean_of("slides"),
        "presses": mean_of("presses"),
        "rocked": mean_of("rocked"),
        "left out": mean_of("left_out"),
        "time, s": mean_of("time"),
        "tilt, °": lambda some: DEG_PER_RAD * max(one.max_tilt for one in some),
        "fell": count("fell"),
        "contradicted": count("contradictory"),
    }
    errors: dict[str, Column] = {
        "mass, %": median("mass_error", 100),
        "within 3 %": fraction("mass_error", MASS_GOAL),
        "within 5 %": fraction("mass_error", ROUGH_MASS_GOAL),
        "center, mm": median("center_error", MM_PER_M),
        "within 3 mm": fraction("center_error", CENTER_GOAL),
        "within 5 mm": fraction("center_error", ROUGH_CENTER_GOAL),
        "friction": median("friction_error", 1),
        "within 0.03": fraction("friction_error", FRICTION_GOAL),
        "mass held": count("mass_holds"),
        "center held": count("center_holds"),
        "friction held": count("friction_holds"),
    }
    work_notes = (
        f"Hidden: mass {MASS_RANGE[0]:g} to {MASS_RANGE[1]:g} kg, friction of each part "
        f"{FRICTION_RANGE[0]:g} to {FRICTION_RANGE[1]:g}. Nothing but the outline is told.",
        f"{CHECKED_PUSH_COUNTS[0]} to {CHECKED_PUSH_COUNTS[-1]} pushes with forces, then presses "
        "at the edge. "
        "Noise: 0.2 N in each sample of the force, 1 mm and 0.3° of each pose, 0.5 mm of the edge.",
        "pushes, slides, presses: means, where an object is laid elsewhere instead of being slid; "
        "rocked, left out: means of the presses in which the object rocked on feet first, and of "
        "those that do not count as tilts about the edge; time: mean of what pushes and presses "
        "took; tilt: the greatest; contradicted: runs in which nothing is stated.",
        f"Greatest move by a press: {MM_PER_M * max(one.moved for one in scores):.2f} mm. Presses "
        f"that objects withstood: {calc_mean([one.no_tilt_count for one in scores]):.2f} a run.",
    )
    error_notes = (
        "mass, center, friction: medians of the errors; held: true values within 95 % intervals "
        "(of the center, a region).",
    )
    rows = by_object(scores, names)
    return [
        Table.of("Weighed at the table's edge", ("object",), rows, work, work_notes),
        Table.of("How well they were weighed", ("object",), rows, errors, error_notes),
    ]


TILT_TEST_JOBS = JobKind(
    job=TiltTestJob, run=run_job, describe=lambda job: f"{job.name}, truth {job.seed}"
)
"""What is done with a job."""

EDGE_TASK = JobKind(
    job=EdgeJob,
    run=run_edge_job,
    describe=lambda job: f"{job.name} to the edge, truth {job.seed}",
)
"""What is done with a job of the second part."""

STUDY = Study(
    name="weighing",
    help="Find mass, center of mass and friction of objects of which nothing is told, by pushes "
    "and presses at the table's edge.",
    options=TiltTestBenchOptions,
    shorten=shorten,
    make_jobs=make_jobs,
    tasks=(TILT_TEST_JOBS, EDGE_TASK),
    tabulate=tabulate,
)
"""`gridpush bench weighing`."""
