"""The registry of the tasks that `gridpush demo`, `robot` and `campaign` know.

What a command needs to know of a task is in a `TaskKind` (`station.task_kind`). A task of your own
is one more name in `TaskName`, and one more `TaskKind` in `TASKS`.
"""

from collections.abc import Callable, Sequence
from enum import StrEnum
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from gridpush_drake.display.overlay import Mark, Phase, to_css
from gridpush_drake.identification.absolute import SIGMAS, AbsoluteEstimate, describe_sources
from gridpush_drake.identification.learning import describe_prior
from gridpush_drake.identification.prediction import calc_mean_cell_error
from gridpush_drake.notebook import MM
from gridpush_drake.notebook import count as count_noun
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.pregrasp.uncertainty import UncertainModel
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.report.follow_figure import draw_follow_run
from gridpush_drake.report.page import ReportSummary, make_report
from gridpush_drake.report.plan_figures import GraspDrawn, PushDrawn, draw_pre_grasp, draw_push_run
from gridpush_drake.report.progress import Expectation, calc_progress
from gridpush_drake.station.follow_task import (
    GONE_COLOR,
    PLANNED_COLOR,
    FollowRecord,
    FollowTask,
)
from gridpush_drake.station.identify_task import IdentifyTask, IdentifyTaskRecord
from gridpush_drake.station.pregrasp_task import PreGraspRecord, PreGraspTask
from gridpush_drake.station.push_task import GOAL_COLOR, PushTask, PushTaskRecord
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.scene_kinds import FetchKind, RearrangeKind, SeparateKind
from gridpush_drake.station.task import ADVANCE, TaskRecord, TaskStatus
from gridpush_drake.station.task_kind import (
    BEFORE_LOOKING,
    FIRST_TITLE,
    HELD_OUT,
    MODEL,
    OBJECT,
    PUSHES,
    RECORDING,
    REPORT,
    SCENARIO,
    STREAM,
    TRUTH,
    WEIGHINGS,
    GoalKind,
    TaskKind,
)
from gridpush_drake.systems.follow_controller import FollowControlStatus, FollowMode
from gridpush_drake.systems.messages import ContactPointMode, PreGraspMode, PushStatus

GRASP_SCENARIO = "grasp"
"""Name of the shipped scenario of the pre-grasp task."""

FOLLOW_SCENARIO = "slalom"
"""Name of the shipped scenario of the task to push along a path."""

FOLLOW_TITLES = {
    FollowMode.POKING: "Poking the object, to learn it",
    FollowMode.PLANNING: "Planning a path",
    FollowMode.GOING: "The finger goes to the object",
    FollowMode.FOLLOWING: "Pushing along the path",
    FollowMode.REACHED: "At the end of the path",
    FollowMode.FAILED: "Given up",
}
"""Titles beside the recording for the modes of the controller that follows a path."""

PUSH_TITLES = {
    ContactPointMode.WAITING: FIRST_TITLE,
    ContactPointMode.PUSHING: "Push {}, toward the goal",
    ContactPointMode.POKING: "Push {}, a poke to learn the object anew",
    ContactPointMode.REACHED: "At the goal",
    ContactPointMode.FAILED: "Given up",
    ContactPointMode.LOST: "The object is out of sight",
}
"""Titles beside the recording for the push controller's modes; {} is the push's number."""

PREGRASP_TITLES = {
    PreGraspMode.WAITING: FIRST_TITLE,
    PreGraspMode.EXPLORING: "Poke {status.pokes}, to learn where the mass is",
    PreGraspMode.SLIDING: "Slide {status.slides}, toward the table's edge",
    PreGraspMode.STOPPING: "Breaking off the push",
    PreGraspMode.WEIGHING: "Weighing it at the table's edge",
    PreGraspMode.VERIFYING: "Checking that it can be grasped here",
    PreGraspMode.GRASPING: "Grasping and lifting",
    PreGraspMode.HOLDING: "Lifted and held",
    PreGraspMode.LOST: "The object is out of sight",
    PreGraspMode.FAILED: "Given up",
}
"""Titles beside the recording for the pre-grasp controller's modes, with its `status`."""


class TaskName(StrEnum):
    """What the robot is to do, as `--task` names it on the command line."""

    identify = "identify"
    push = "push"
    pregrasp = "pregrasp"
    follow = "follow"
    separate = "separate"
    rearrange = "rearrange"
    fetch = "fetch"


class IdentifyKind(TaskKind):
    """A robot pokes an object it knows nothing about, and comes to know it."""

    station = IdentifyTask
    has_goal = False
    files = (REPORT, RECORDING, MODEL, OBJECT, PUSHES, HELD_OUT, STREAM, TRUTH, SCENARIO)

    def count_steps(self, scenario: PushScenario) -> int:
        """Counts the pushes to learn from and those held out."""
        return scenario.pokes.count + scenario.pokes.test_count

    def describe_step(self, task: Any, status: PushStatus) -> tuple[str, int]:
        """Names the push that is being made, and why others were refused."""
        scenario = task.station.scenario
        total = self.count_steps(scenario)
        kind = "push" if status.executed < scenario.pokes.count else "held-out push"
        refused = ""
        if status.reason:
            refused = f" (refused {status.refused}: {status.reason})"
        number = min(status.executed + 1, total)
        return f"{kind} {number} of {total}, {status.phase}{refused}", status.executed

    def list_phases(self, record: IdentifyTaskRecord) -> list[Phase]:
        """Lists the phases of all pushes: first those to learn from, then those held out."""
        return [self._name_push(status, time, record.training) for time, status in record.phases]

    def describe_phase(self, task: Any, status: PushStatus, time: float) -> Phase | None:
        """Describes what the executor of pushes does."""
        return self._name_push(status, time, task.station.scenario.pokes.count)

    def _name_push(self, status: PushStatus, time: float, training: int) -> Phase:
        """Makes a phase of an executor's status; the first `training` pushes are learned from."""
        begun = status.executed + (not status.ready)
        if begun == 0:
            return Phase(0.0, FIRST_TITLE, BEFORE_LOOKING)
        held_out = begun > training
        kind = "Held-out push" if held_out else "Push"
        title = FIRST_TITLE if status.ready else f"{kind} {begun}: {status.phase}"
        detail = "Predicted only, to test what was learned." if held_out else ""
        return Phase(max(0.0, time - ADVANCE), title, detail)

    def split_log(self, record: IdentifyTaskRecord) -> tuple[PushLog, PushLog]:
        """Splits the log by the scenario's counts."""
        return record.training_log, record.held_out_log

    def make_report(self, record: IdentifyTaskRecord, recording: str | None = None) -> str:
        """Makes the report, which shows how the error of the held-out pushes fell, push by push."""
        training, held_out = self.split_log(record)
        result = record.estimates[-1]
        progress = calc_progress(record.estimates, training, record.truth)
        if not len(held_out):
            return make_report(
                result,
                training,
                truth=record.truth,
                sight=record.sight,
                progress=progress,
                recording=recording,
            )
        learning = [
            calc_mean_cell_error(record.obj, estimate.params, held_out, result.physics)
            for estimate in (describe_prior(record.obj), *record.estimates)
        ]
        return make_report(
            result,
            training,
            held_out,
            record.truth,
            learning,
            sight=record.sight,
            progress=progress,
            recording=recording,
        )

    def summarize(self, record: IdentifyTaskRecord) -> dict[str, Any]:
        """Adds to the summary the errors before and after learning."""
        summary = super().summarize(record)
        summary["pushes"] = len(record.training_log)
        summary["held_out"] = len(record.held_out_log)
        if not record.estimates:
            return summary
        estimate = record.estimates[-1]
        summary["learned"] = estimate.message
        center_errors = _calc_center_errors(record)
        compared = {"before": CellParameters.uniform(record.obj), "after": estimate.params}
        for name, params in compared.items():
            held_out_error = calc_mean_cell_error(
                record.obj, params, record.held_out_log, estimate.physics
            )
            summary[name] = {"held_out_cell_error": held_out_error}
            if center_errors:
                summary[name]["center_of_mass_error"] = center_errors[name]
        return summary

    def describe(self, summary: dict[str, Any]) -> list[str]:
        """Tells what was learned, and the errors before and after learning."""
        name = summary["object"].replace("_", " ")
        lines = [summary["message"]] if summary["status"] != TaskStatus.FINISHED else []
        if "after" not in summary:
            return [*lines, f"Nothing was learned about the {name}."]
        lines.append(f"The {name} after {summary['pushes']} pushes: {summary['learned']}")
        if summary["held_out"]:
            what = f"error of {summary['held_out']} pushes held out"
            lines.append(_compare(what, "held_out_cell_error", summary))
        if "center_of_mass_error" in summary["after"]:
            lines.append(_compare("error of the center of mass", "center_of_mass_error", summary))
        return lines


class PushKind(GoalKind):
    """A robot pushes an object it knows nothing about to a goal, and learns it on the way."""

    station = PushTask
    done = TaskStatus.REACHED
    marks = (Mark(to_css(GOAL_COLOR), "where the object should lie"),)

    def name_phase(self, status: Any) -> str:
        """Returns a title with the push's number."""
        return PUSH_TITLES[status.mode].format(status.pushes + 1)

    def summarize(self, record: PushTaskRecord) -> dict[str, Any]:
        """Adds to the summary how far from the goal the object ended."""
        return super().summarize(record) | {
            "pushes": record.pushes,
            "goal": [float(value) for value in record.goal],
            "error": record.error,
        }

    def describe(self, summary: dict[str, Any]) -> list[str]:
        """Tells how far from the goal the object ended."""
        name = summary["object"].replace("_", " ")
        left = f"{summary['error'] * MM:.1f} mm"
        return [
            f"The {name} after {summary['pushes']} pushes: {summary['message']}",
            f"  mean distance of its cells from where they should be: {left}",
        ]

    def make_summary(self, record: PushTaskRecord) -> ReportSummary:
        """Shows where the object lay after every push."""
        steps = []
        for number, (seen, pose) in enumerate(
            zip(record.log, record.rest_poses[1:], strict=False), start=1
        ):
            x, y = seen.push.start.tolist()
            left = float(calc_goal_error(record.obj, pose, record.goal)) * MM
            where = f"({x:.3f}, {y:.3f}) m, {seen.push.length * MM:.0f} mm far"
            steps.append((str(number), where, f"{left:.0f} mm"))
        return ReportSummary(
            headline=record.message,
            facts=(
                ("pushes", str(record.pushes)),
                ("left to go", f"{record.error * MM:.1f} mm"),
                ("simulated", f"{record.duration:.0f} s"),
            ),
            figure=draw_push_run(
                record.obj,
                record.rest_poses,
                [seen.push for seen in record.log],
                record.goal,
                record.surface,
                expected=record.expected_errors,
                tolerance=record.tolerance,
            ),
            caption="The object at rest after every push, the pushes as arrows, the goal dotted; "
            "and how far off it was.",
            heads=("push", "from", "left to go"),
            steps=steps,
        )


class PreGraspKind(TaskKind):
    """A robot pokes an object, learns it, slides it to the table's edge, grasps and lifts it."""

    station = PreGraspTask
    done = TaskStatus.HELD
    scenario = GRASP_SCENARIO
    files = (REPORT, RECORDING, MODEL, OBJECT, PUSHES, WEIGHINGS, STREAM, TRUTH, SCENARIO)
    grasps = True

    def describe_step(self, task: Any, status: PushStatus) -> tuple[str, int]:
        """Names what the controller is doing."""
        now = task.read("status", task.controller)
        return f"{now.mode}, {_count_pushes(now.pokes, now.slides)}", int(now.over)

    def name_phase(self, status: Any) -> str:
        """Returns a title with the number of the poke or slide."""
        return PREGRASP_TITLES[status.mode].format(status=status)

    def summarize(self, record: PreGraspRecord) -> dict[str, Any]:
        """Adds to the summary whether the object was lifted, and how well its center was known."""
        summary = super().summarize(record) | {
            "pokes": record.last.pokes,
            "slides": record.last.slides,
            "grasps": record.last.grasps,
            "presses": record.last.presses,
            "raised": record.raised,
        }
        if record.estimates:
            for name, error in _calc_center_errors(record).items():
                summary[name] = {"center_of_mass_error": error}
        if record.estimates and record.estimates[-1].absolute is not None:
            summary["weighed"] = summarize_weighed(record.estimates[-1].absolute, record)
        return summary

    def describe(self, summary: dict[str, Any]) -> list[str]:
        """Tells whether the object was lifted, and how well its center of mass was known."""
        name = summary["object"].replace("_", " ")
        pushes = _count_pushes(summary["pokes"], summary["slides"])
        lines = [f"The {name} after {pushes}: {summary['message']}"]
        if "after" in summary:
            lines.append(_compare("error of the center of mass", "center_of_mass_error", summary))
        if "weighed" in summary:
            weighed = summary["weighed"]
            lines.append(f"  weighed by {weighed['sources']}, each with a probability of 95 %:")
            lines += [f"  {what}: {value}, {more}" for what, value, more in list_weighed(weighed)]
        return lines

    def list_expectations(self, record: PreGraspRecord) -> list[Expectation]:
        """Lists how well each poke was expected to tell the center of mass.

        Some pokes are chosen for the center's distance from the table's edge alone; their forecast
        is of something else, and is left out.
        """
        expectations = []
        for step in record.steps:
            status = step.status
            forecast = status.forecast
            if step.push is None or status.mode != PreGraspMode.EXPLORING or forecast is None:
                continue
            if not forecast.across_edge:
                pushes = status.pokes + status.slides
                expectations.append(Expectation(pushes, forecast.expected_std))
        return expectations

    def make_summary(self, record: PreGraspRecord) -> ReportSummary:
        """Shows the object's way to the edge, and how safely it lies there."""
        last = record.last
        raised = f"{record.raised * MM:.0f} mm" if np.isfinite(record.raised) else "not measured"
        facts: list[tuple[str, str]] = []
        if record.estimates and record.estimates[-1].absolute is not None:
            weighed = summarize_weighed(record.estimates[-1].absolute, record)
            facts = [(f"{what}, {more}", value) for what, value, more in list_weighed(weighed)]
        return ReportSummary(
            headline=f"{record.message} It took {_count_pushes(last.pokes, last.slides)}.",
            facts=(
                ("pokes", str(last.pokes)),
                ("slides", str(last.slides)),
                ("simulated", f"{record.duration:.0f} s"),
                ("raised by", raised),
                *facts,
            ),
            figure=_draw_pre_grasp(record),
            caption="Left: pokes to learn, then slides to the table's edge. Right: as long as its "
            "center of mass is within what holds the object it stays put; it was judged on every "
            "place where the center of mass may still be.",
            heads=("time", "what", "why"),
            steps=[
                (f"{step.time:.1f}\N{NO-BREAK SPACE}s", step.status.mode, step.status.reason)
                for step in record.steps
                if step.status.mode != PreGraspMode.WAITING
            ],
        )


def summarize_weighed(absolute: AbsoluteEstimate, record: PreGraspRecord) -> dict[str, Any]:
    """Summarizes what weighings said, in SI units, beside the truth if somebody knows that."""
    summary = absolute.summarize() | {"sources": describe_sources(absolute)}
    for key in ("center_of_mass", "center_of_mass_covariance"):
        summary[key] = summary[key].tolist()
    truth = record.truth
    if truth is not None:
        mass = float(truth.total_mass)
        summary["true"] = {
            "total_mass": mass,
            "center_of_mass": truth.center_of_mass(record.obj).tolist(),
            "friction": float(truth.mass @ truth.friction) / mass,
        }
    return summary


def list_weighed(weighed: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Lists what weighings said, in words: what it is, its value, and interval beside the truth.

    Args:
        weighed: what `summarize_weighed` returned.
    """
    true = weighed.get("true")

    def add_truth(interval: str, key: str, describe: Callable[[Any], str]) -> str:
        """Adds to an interval what is true."""
        return interval if true is None else f"{interval}; truly {describe(true[key])}"

    def describe_mass(mass: float) -> str:
        return f"{mass:.3f} kg"

    def describe_place(place: Sequence[float]) -> str:
        x, y = (MM * value for value in place)
        return f"x {x:.1f} mm, y {y:.1f} mm"

    def describe_friction(friction: float) -> str:
        return f"{friction:.3f}"

    low, high = weighed["total_mass_interval"]
    reach = SIGMAS * MM * np.sqrt(np.diag(weighed["center_of_mass_covariance"]))
    listed = [
        (
            "mass",
            describe_mass(weighed["total_mass"]),
            add_truth(f"{low:.3f} to {high:.3f} kg", "total_mass", describe_mass),
        ),
        (
            "center of mass",
            describe_place(weighed["center_of_mass"]),
            add_truth(f"± {reach[0]:.1f} and {reach[1]:.1f} mm", "center_of_mass", describe_place),
        ),
    ]
    if weighed["friction"] is not None:
        low, high = weighed["friction_interval"]
        interval = add_truth(f"{low:.3f} to {high:.3f}", "friction", describe_friction)
        listed.append(("mean friction", describe_friction(weighed["friction"]), interval))
    return listed


def _draw_pre_grasp(record: PreGraspRecord) -> Figure:
    """Draws the report's figure of pokes, slides and grasp."""
    poses = [
        step.pose for step in record.steps if np.isfinite(step.pose).all() and not step.status.over
    ]
    pushes = [
        PushDrawn(step.push.start, step.push.end, step.status.mode == PreGraspMode.EXPLORING)
        for step in record.steps
        if step.push is not None
    ]
    grasps = [step.grasp for step in record.steps if step.grasp is not None]
    last_grasp = None
    if grasps:
        last_grasp = GraspDrawn(np.array([grasps[-1].x, grasps[-1].y]), grasps[-1].approach)
    return draw_pre_grasp(
        record.obj,
        record.surface,
        poses,
        pushes,
        masses=UncertainModel.of_identification(record.estimates[-1], log=record.log).masses,
        truth=record.truth,
        grasp=last_grasp,
    )


class FollowKind(TaskKind):
    """A robot pokes an object, learns it, and pushes it along a path with feedback."""

    station = FollowTask
    done = TaskStatus.REACHED
    scenario = FOLLOW_SCENARIO
    hides = True
    marks = (
        Mark(to_css(PLANNED_COLOR), "where the object should go, and lie at the end"),
        Mark(to_css(GONE_COLOR), "where it went"),
    )

    def count_steps(self, scenario: PushScenario) -> int:
        """Counts the pokes, and the path."""
        return scenario.pokes.count + 1

    def describe_step(self, task: Any, status: PushStatus) -> tuple[str, int]:
        """Names the poke, or what the controller does afterwards."""
        now: FollowControlStatus = task.read("status", task.controller)
        if now.mode == FollowMode.POKING:
            return f"poke {status.executed + (not status.ready)}, {status.phase}", status.executed
        return FOLLOW_TITLES[now.mode], status.executed

    def name_phase(self, status: Any) -> str:
        """Returns a title for what the controller does."""
        return FOLLOW_TITLES[status.mode]

    def summarize(self, record: FollowRecord) -> dict[str, Any]:
        """Adds to the summary how the object kept to its path, and where it ended."""
        return super().summarize(record) | {
            "cause": record.last.cause,
            "pokes": record.pokes,
            "plans": record.last.plans,
            "goal": record.goal.tolist(),
            "distance": record.distance,
            "turn": record.turn,
            "path_rms": record.calc_rms(),
            "steering_seconds": record.steering_time,
            "clearance": record.calc_clearance() if record.obstacles else None,
        }

    def describe(self, summary: dict[str, Any]) -> list[str]:
        """Tells whether the object came to the path's end, and how near it kept to the path."""
        name = summary["object"].replace("_", " ")
        pokes = count_noun(summary["pokes"], "poke")
        lines = [f"The {name} after {pokes}: {summary['message']}"]
        if np.isfinite(summary["path_rms"]):
            lines.append(
                f"  in {summary['steering_seconds']:.1f} s, {summary['path_rms'] * MM:.1f} mm from "
                f"its path (root mean square); {summary['distance'] * MM:.1f} mm and "
                f"{np.degrees(summary['turn']):.1f}° from the end"
            )
        force = summary["limit_report"]["force"]
        lines.append(f"  greatest force on the finger: {force:.1f} N")
        if summary["limit_report"]["touched"]:
            pairs = (" and ".join(pair) for pair in summary["limit_report"]["touched"])
            lines.append(f"  these touched, but should not: {'; '.join(pairs)}")
        return lines

    def make_summary(self, record: FollowRecord) -> ReportSummary:
        """Shows the path, the object's way and what stood in it."""
        path = record.paths[-1] if record.paths else None
        away = f"{record.calc_clearance() * MM:.0f} mm" if record.obstacles else "nothing there"
        return ReportSummary(
            headline=record.message,
            facts=(
                ("pokes", str(record.pokes)),
                ("on its way", f"{record.steering_time:.1f} s"),
                ("from the path, RMS", f"{record.calc_rms() * MM:.1f} mm"),
                ("nearest to an obstacle", away),
                ("greatest force", f"{record.limit_report.force:.1f} N"),
            ),
            figure=draw_follow_run(
                record.obj,
                planned=np.empty((0, 3)) if path is None else path.poses,
                poses=record.poses,
                tips=record.tips,
                times=record.times,
                distances=record.calc_distances(),
                goal=record.goal,
                surface=record.surface,
                obstacles=record.obstacles,
            ),
            caption="Left: the path of the object's middle as it was planned, its way, and the "
            "finger's; the object dotted where it should end. Right: how far the middle was from "
            "its path.",
            heads=("time", "what", "why"),
            steps=[
                (f"{step.time:.1f}\N{NO-BREAK SPACE}s", step.status.mode, step.status.reason)
                for step in record.steps
            ],
        )


TASKS: dict[str, TaskKind] = {
    TaskName.identify: IdentifyKind(),
    TaskName.push: PushKind(),
    TaskName.pregrasp: PreGraspKind(),
    TaskName.follow: FollowKind(),
    TaskName.separate: SeparateKind(),
    TaskName.rearrange: RearrangeKind(),
    TaskName.fetch: FetchKind(),
}
"""The kinds of tasks by their names. A name is a `TaskName`, or simply its text."""


def calc_center_error(record: TaskRecord, params: CellParameters) -> float:
    """Calculates the distance of an estimate's center of mass from the true one, m.

    The record is of a simulated run, in which the truth is known.
    """
    assert record.truth is not None
    estimated = params.center_of_mass(record.obj)
    true = record.truth.center_of_mass(record.obj)
    return float(np.linalg.norm(estimated - true))


def _calc_center_errors(record: Any) -> dict[str, float]:
    """Calculates the errors of the center of mass, m, "before" and "after" learning.

    Before, the object is assumed to be even. The result is empty if nobody knows the truth.
    """
    if record.truth is None:
        return {}
    compared = {"before": CellParameters.uniform(record.obj), "after": record.estimates[-1].params}
    return {name: calc_center_error(record, params) for name, params in compared.items()}


def _compare(what: str, key: str, summary: dict[str, Any]) -> str:
    """Compares an error, m, in the summary before and after learning, in a line of words."""
    before = summary["before"][key] * MM
    after = summary["after"][key] * MM
    return f"  {what}: {before:.1f} mm assuming an even object, {after:.1f} mm as learned"


def _count_pushes(pokes: int, slides: int) -> str:
    """Says how many pokes and slides were made."""
    return f"{count_noun(pokes, 'poke')} and {count_noun(slides, 'slide')}"
