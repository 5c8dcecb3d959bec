"""`gridpush bench feedback`: pushing with feedback, in the LCP world and with bodies in MuJoCo.

Learned objects are pushed along paths, to goals, and back to goals after shoves. What a run is and
how it is judged is in `bench.steering.runs`; sessions with a hidden weight, in which nothing is
known of a body at first, are in `bench.steering.hidden_weight`. Here is which of them are made, and
their tables.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gridpush_drake.bench.steering.hidden_weight import (
    GOAL_ANGLE,
    GOAL_POSITION,
    START_PLACE,
    WEIGHT_TASKS,
    SessionJob,
    run_session,
)
from gridpush_drake.bench.steering.runs import (
    DISTURBED_RUN,
    EVEN_MODEL,
    GOAL_DISTANCE,
    GOAL_RUN,
    LEARNED_MODEL,
    LEARNING_MODEL,
    MODEL_NAMES,
    MOST_TIME,
    OBJECT_NAMES,
    PATH_LENGTH,
    PATH_RUN,
    PATH_SPEED,
    PRIMITIVE_PLANNER,
    RUN_KINDS,
    TRUE_MODEL,
    WANTED_RMS,
    FeedbackJob,
    Followed,
    run_job,
)
from gridpush_drake.bench.steering.worlds import LCP_WORLD, POSE_SENSOR, STEERED_WORLDS
from gridpush_drake.bench.study import OBJECTS_OPTION, Done, JobKind, Study, StudyOptions, option
from gridpush_drake.bench.truth.sets import FOUNDATION_KIND
from gridpush_drake.errors import GridPushError
from gridpush_drake.extras import import_extra
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.pushes.push_csv import PUSHER_HELP, parse_pusher
from gridpush_drake.report.table import INTERVAL_CONFIDENCE, Proportion, Table
from gridpush_drake.units import DEG_PER_RAD, MM_PER_M, MS_PER_S

DEFAULT_RUN_COUNT = 10
QUICK_RUNS = 1

DEFAULT_EPISODE_COUNT = 10
"""Number of episodes of a session with a hidden weight by default."""

SESSION_MODELS = (LEARNING_MODEL, EVEN_MODEL)
"""What is planned with in sessions with a hidden weight."""


@dataclass(frozen=True)
class FeedbackBenchOptions(StudyOptions):
    """What is measured.

    Attributes:
        kinds: what is done.
        worlds: names of worlds.
        objects: names of shipped objects; NAMES where None.
        models: names of MODEL_NAMES, what is planned with.
        runs: runs of each kind, world, object and model; the first has the seed `seed`. Of sessions
            with a hidden weight, which have objects of their own, the number of bodies.
        episodes: number of episodes of such a session.
        pusher: shape of a finger that is no disc, as `parse_pusher` reads it; none of sessions.
    """

    kinds: tuple[str, ...] | None = option(
        None,
        "path, goal or shove; or a session with a hidden weight, as in Phys2Real: t_bottom, t_top "
        "or hammer; may be repeated.",
        name="--kind",
        metavar="KIND",
        shown="path, goal and shove",
    )
    worlds: tuple[str, ...] | None = option(
        None,
        "lcp, foundation or three_feet; may be repeated.",
        name="--world",
        metavar="WORLD",
        shown="all; foundation of a session",
    )
    objects: tuple[str, ...] | None = option(None, **OBJECTS_OPTION)
    models: tuple[str, ...] | None = option(
        None,
        "What is planned with: learned, learning (on the way, too), even, true (in the LCP world "
        "only) or strokes (to goals in the LCP world only); may be repeated.",
        name="--model",
        metavar="MODEL",
        shown="all",
    )
    runs: int = option(DEFAULT_RUN_COUNT, "Runs of each kind, world, object and model.", least=1)
    episodes: int = option(
        DEFAULT_EPISODE_COUNT, "Episodes of each session with a hidden weight.", least=1
    )
    pusher: str | None = option(
        None,
        f"Shape of a finger that is no disc and is steered with its angle: {PUSHER_HELP}",
        metavar="SHAPE",
    )


def shorten(options: FeedbackBenchOptions) -> FeedbackBenchOptions:
    """Makes the options of the quick variant."""
    return replace(
        options,
        runs=min(options.runs, QUICK_RUNS),
        episodes=min(options.episodes, QUICK_RUNS),
        worlds=options.worlds or (LCP_WORLD,),
        objects=options.objects or OBJECT_NAMES[:1],
    )


def make_jobs(options: FeedbackBenchOptions) -> list[FeedbackJob | SessionJob]:
    """Makes the runs, and the sessions with a hidden weight.

    Raises:
        GridPushError: a kind, world or model is not known, or there is no run.
        ObjectError: an object is not shipped.
        MissingExtraError: MuJoCo is asked for, and not installed.
    """
    kinds = options.kinds or RUN_KINDS
    are_sessions = set(kinds) <= set(WEIGHT_TASKS)
    worlds = options.worlds or ((FOUNDATION_KIND,) if are_sessions else STEERED_WORLDS)
    models = options.models or MODEL_NAMES
    if options.pusher is not None:
        # read once, so that a shape of no known form is refused before anything is done
        parse_pusher("--pusher", options.pusher)
        models = options.models or tuple(name for name in MODEL_NAMES if name != PRIMITIVE_PLANNER)
        if are_sessions or PRIMITIVE_PLANNER in models:
            raise GridPushError(
                "pusher: strokes and sessions with a hidden weight are by a disc; expected none"
            )
    choices = (
        ("kind", kinds, (*RUN_KINDS, *WEIGHT_TASKS)),
        ("world", worlds, STEERED_WORLDS),
        ("model", models, MODEL_NAMES),
    )
    for what, names, known in choices:
        for name in names:
            if name not in known:
                raise GridPushError(f"{what}: {name!r}; expected one of {', '.join(known)}")
    if options.runs < 1:
        raise GridPushError("runs: none; expected at least one")
    if set(worlds) != {LCP_WORLD}:
        import_extra("mujoco", "bench")
    names = options.objects or OBJECT_NAMES
    for name in names:
        find_shipped_object(name)
    jobs: list[FeedbackJob | SessionJob] = [
        FeedbackJob(kind, world, name, model, options.seed + i, pusher=options.pusher or "")
        for kind in kinds
        if kind in RUN_KINDS
        for world in worlds
        for model in list_models(kind, world)
        if model in models
        for name in names
        for i in range(options.runs)
    ]
    # Body by body, so that what is done after some time is of all tasks and models.
    jobs += [
        SessionJob(
            kind=kind, world=world, model=model, seed=options.seed + i, episodes=options.episodes
        )
        for i in range(options.runs)
        for kind in kinds
        if kind in WEIGHT_TASKS
        for world in worlds
        for model in SESSION_MODELS
        if model in models
    ]
    if not jobs:
        raise GridPushError(
            f"model: nothing is done with {', '.join(models)} for these kinds and worlds; expected "
            f"one of {', '.join(list_models(kinds[0], worlds[0]))}"
        )
    return jobs


def list_models(kind: str, world: str) -> tuple[str, ...]:
    """Lists what is planned with: the truth of a body in MuJoCo is no grid."""
    if kind in WEIGHT_TASKS:
        return SESSION_MODELS
    if world != LCP_WORLD:
        return (LEARNED_MODEL, LEARNING_MODEL, EVEN_MODEL)
    known = (LEARNED_MODEL, LEARNING_MODEL, EVEN_MODEL, TRUE_MODEL)
    return (*known, PRIMITIVE_PLANNER) if kind == GOAL_RUN else known


def tabulate(options: FeedbackBenchOptions, done: Done) -> list[Table]:
    """Makes a table of each kind of runs."""
    results = done.of(RUN_JOBS)
    makers = {PATH_RUN: tabulate_paths, GOAL_RUN: tabulate_goals, DISTURBED_RUN: tabulate_goals}
    tables = []
    for kind, tabulate_kind in makers.items():
        found = [each for each in results if each.kind == kind]
        if found:
            tables.append(tabulate_kind(kind, found))
    sessions = done.of(SESSION_JOBS)
    return [*tables, tabulate_sessions(sessions)] if sessions else tables


def _group(results: Sequence[Followed]) -> list[tuple[tuple[str, str], list[Followed]]]:
    """Makes groups of a table: the runs of each world and model."""
    keys = dict.fromkeys((each.world, each.model) for each in results)
    return [(key, [r for r in results if (r.world, r.model) == key]) for key in keys]


def _quantile(field: str, fraction: float, scale: float) -> Any:
    """Makes a column of a table: a quantile of a field of the runs that reached the end."""

    def calc(results: Sequence[Followed]) -> float:
        values = [getattr(each, field) for each in results if each.reached]
        return scale * float(np.quantile(values, fraction)) if values else np.nan

    return calc


def _count_reached(results: Sequence[Followed]) -> str:
    """How many runs reached the end, with the interval."""
    return Proportion.of(sum(each.reached for each in results), len(results)).describe()


def _count_near(results: Sequence[Followed]) -> str:
    """How many runs reached the end, and kept as near to the path as is wanted."""
    near = [each.reached and each.rms <= WANTED_RMS for each in results]
    return Proportion.of(sum(near), len(results)).describe()


CORE_TIME = _quantile("decision", 0.5, MS_PER_S)
"""Column of the median time of a decision."""


def tabulate_paths(kind: str, results: Sequence[Followed]) -> Table:
    """Tabulates runs along a path."""
    columns = {
        "runs": len,
        "to the end": _count_reached,
        f"RMS within {WANTED_RMS * MM_PER_M:g} mm": _count_near,
        "RMS, median, mm": _quantile("rms", 0.5, MM_PER_M),
        "RMS, 9 in 10, mm": _quantile("rms", 0.9, MM_PER_M),
        "time, s": _quantile("time", 0.5, 1.0),
        "decision, ms": CORE_TIME,
    }
    notes = (
        f"An S of {PATH_LENGTH * 100:g} cm at {PATH_SPEED * 100:g} cm/s, after three pokes; poses "
        f"{POSE_SENSOR.delay:g} s late, one in ten missing. The learned grid is that of the pokes.",
        f"With {INTERVAL_CONFIDENCE:.0%} Wilson intervals. Figures are of the runs that came to "
        "the end.",
    )
    return Table.of("Along a path", ("world", "model"), _group(results), columns, notes)


def tabulate_goals(kind: str, results: Sequence[Followed]) -> Table:
    """Tabulates runs to a goal, or back to it after a shove."""
    columns = {
        "runs": len,
        "reached": _count_reached,
        "time, median, s": _quantile("time", 0.5, 1.0),
        "time, 9 in 10, s": _quantile("time", 0.9, 1.0),
        "off, median, mm": _quantile("distance", 0.5, MM_PER_M),
        "off, median, °": _quantile("turn", 0.5, DEG_PER_RAD),
        "decision, ms": CORE_TIME,
    }
    what = {
        GOAL_RUN: f"A goal {GOAL_DISTANCE * 100:g} cm away, to 2 mm and 1°.",
        DISTURBED_RUN: "Back to the goal after a shove of 3 cm and 20°, to 2 mm and 1°.",
    }
    notes = (
        f"{what[kind]} Times are of the runs that reached it, given up after {MOST_TIME:g} s.",
        "Stroke by stroke: until the mean cell error is 2 mm; the time is what a station's arm "
        "takes for the strokes, up, over, down and along. Nothing is counted for looking and "
        "planning.",
        f"With {INTERVAL_CONFIDENCE:.0%} Wilson intervals.",
    )
    title = {GOAL_RUN: "To a goal", DISTURBED_RUN: "After a shove"}[kind]
    return Table.of(title, ("world", "model"), _group(results), columns, notes)


def tabulate_sessions(sessions: Sequence[Sequence[Followed]]) -> Table:
    """Tabulates sessions with a hidden weight: all episodes, and those of a known body."""

    def find_time(episodes: Sequence[int]) -> Any:
        """Makes a column: median time of the successes among some episodes of each session."""

        def calc(group: Sequence[Sequence[Followed]]) -> float:
            times = [
                one.time
                for session in group
                for i, one in enumerate(session)
                if i in episodes and one.reached
            ]
            return float(np.median(times)) if times else np.nan

        return calc

    def count_reached(group: Sequence[Sequence[Followed]]) -> str:
        return _count_reached([one for session in group for one in session])

    keys = dict.fromkeys((each[0].kind, each[0].world, each[0].model) for each in sessions)
    groups = [
        (key, [each for each in sessions if (each[0].kind, each[0].world, each[0].model) == key])
        for key in keys
    ]
    most = max(map(len, sessions))
    columns = {
        "bodies": len,
        "episodes": lambda group: sum(map(len, group)),
        "reached": count_reached,
        "time, median, s": find_time(range(most)),
        "first episode, s": find_time(range(1)),
        "later ones, s": find_time(range(1, most)),
    }
    notes = (
        f"From {np.linalg.norm(START_PLACE) * 100:g} cm away, turned anywhere, to "
        f"{GOAL_POSITION * 100:g} cm and {GOAL_ANGLE * DEG_PER_RAD:g}° at rest, by the true pose; "
        f"given up after {MOST_TIME:g} s. Times are of the episodes that reached it.",
        "learning: begins with an even object, learns on the way, and carries what it learned from "
        "episode to episode. even: plans with an even object in all episodes.",
        f"With {INTERVAL_CONFIDENCE:.0%} Wilson intervals.",
    )
    return Table.of("Hidden weight", ("task", "world", "model"), groups, columns, notes)


RUN_JOBS = JobKind(job=FeedbackJob, run=run_job, describe=FeedbackJob.describe)
"""What is done with a run."""

SESSION_JOBS = JobKind(job=SessionJob, run=run_session, describe=SessionJob.describe)
"""What is done with a session."""

STUDY = Study(
    name="feedback",
    help="Push learned objects with feedback, along paths, to goals and back after shoves: in the "
    "LCP world, and bodies in MuJoCo.",
    options=FeedbackBenchOptions,
    tabulate=tabulate,
    tasks=(RUN_JOBS, SESSION_JOBS),
    make_jobs=make_jobs,
    shorten=shorten,
)
"""The command."""
