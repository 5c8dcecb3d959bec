"""The registry of the tasks that `gridpush demo`, `robot` and `campaign` know.

What a command needs to know of a task is in a `TaskKind` (`station.tasks.task_kind`). A task of
your own is one more name in `TaskName`, and one more `TaskKind` in `TASK_KINDS`. The kinds of the
two tasks that only push are in this file, the others in `station.tasks.pregrasp_kind`,
`station.tasks.follow_kind` and `station.tasks.scene_kinds`.
"""

from enum import StrEnum
from typing import Any

from gridpush_drake.display.overlay import Mark, Phase, to_css
from gridpush_drake.identification.learning import describe_prior
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import calc_mean_cell_error
from gridpush_drake.objects.object_file import speak_name
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.report.page import ReportSummary, make_report
from gridpush_drake.report.plan_figures import draw_push_run
from gridpush_drake.report.progress import calc_progress
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.tasks.follow_kind import FollowKind
from gridpush_drake.station.tasks.identify_task import IdentifyTask, IdentifyTaskRecord
from gridpush_drake.station.tasks.pregrasp_kind import PreGraspKind
from gridpush_drake.station.tasks.push_task import GOAL_COLOR, PushTask, PushTaskRecord
from gridpush_drake.station.tasks.run_summary import calc_center_errors, compare_errors
from gridpush_drake.station.tasks.scene_kinds import FetchKind, RearrangeKind, SeparateKind
from gridpush_drake.station.tasks.task import OBSERVATION_PERIOD, TaskStatus
from gridpush_drake.station.tasks.task_kind import (
    BEFORE_LOOKING,
    FIRST_TITLE,
    HELD_OUT,
    MODEL_FILE,
    OBJECT_FILE,
    PUSHES_FILE,
    RECORDING_FILE,
    REPORT_FILE,
    SCENARIO_FILE,
    STREAM_FILE,
    TRUTH_FILE,
    GoalKind,
    TaskKind,
)
from gridpush_drake.systems.base.messages import ContactPointMode, PushStatus
from gridpush_drake.units import MM_PER_M

PUSH_TITLES = {
    ContactPointMode.WAITING: FIRST_TITLE,
    ContactPointMode.PUSHING: "Push {}, toward the goal",
    ContactPointMode.POKING: "Push {}, a poke to learn the object anew",
    ContactPointMode.REACHED: "At the goal",
    ContactPointMode.FAILED: "Given up",
    ContactPointMode.LOST: "The object is out of sight",
}
"""Titles beside the recording for the push controller's modes; {} is the push's number."""


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
    files = (
        REPORT_FILE,
        RECORDING_FILE,
        MODEL_FILE,
        OBJECT_FILE,
        PUSHES_FILE,
        HELD_OUT,
        STREAM_FILE,
        TRUTH_FILE,
        SCENARIO_FILE,
    )

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
        return Phase(max(0.0, time - OBSERVATION_PERIOD), title, detail)

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
                camera_view=record.camera_view,
                progress=progress,
                recording=recording,
            )
        learning = [
            calc_mean_cell_error(Model(record.obj, estimate.params, result.physics), held_out)
            for estimate in (describe_prior(record.obj), *record.estimates)
        ]
        return make_report(
            result,
            training,
            held_out,
            record.truth,
            learning,
            camera_view=record.camera_view,
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
        center_errors = calc_center_errors(record)
        compared = {"before": CellParameters.uniform(record.obj), "after": estimate.params}
        for name, params in compared.items():
            held_out_error = calc_mean_cell_error(
                Model(record.obj, params, estimate.physics), record.held_out_log
            )
            summary[name] = {"held_out_cell_error": held_out_error}
            if center_errors:
                summary[name]["center_of_mass_error"] = center_errors[name]
        return summary

    def describe(self, summary: dict[str, Any]) -> list[str]:
        """Tells what was learned, and the errors before and after learning."""
        name = speak_name(summary["object"])
        lines = [summary["message"]] if summary["status"] != TaskStatus.FINISHED else []
        if "after" not in summary:
            return [*lines, f"Nothing was learned about the {name}."]
        lines.append(f"The {name} after {summary['pushes']} pushes: {summary['learned']}")
        if summary["held_out"]:
            what = f"error of {summary['held_out']} pushes held out"
            lines.append(compare_errors(what, "held_out_cell_error", summary))
        if "center_of_mass_error" in summary["after"]:
            lines.append(
                compare_errors("error of the center of mass", "center_of_mass_error", summary)
            )
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
        name = speak_name(summary["object"])
        left = f"{summary['error'] * MM_PER_M:.1f} mm"
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
            left = float(calc_goal_error(record.obj, pose, record.goal)) * MM_PER_M
            where = f"({x:.3f}, {y:.3f}) m, {seen.push.length * MM_PER_M:.0f} mm far"
            steps.append((str(number), where, f"{left:.0f} mm"))
        return ReportSummary(
            headline=record.message,
            facts=(
                ("pushes", str(record.pushes)),
                ("left to go", f"{record.error * MM_PER_M:.1f} mm"),
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


TASK_KINDS: dict[str, TaskKind] = {
    TaskName.identify: IdentifyKind(),
    TaskName.push: PushKind(),
    TaskName.pregrasp: PreGraspKind(),
    TaskName.follow: FollowKind(),
    TaskName.separate: SeparateKind(),
    TaskName.rearrange: RearrangeKind(),
    TaskName.fetch: FetchKind(),
}
"""The kinds of tasks by their names. A name is a `TaskName`, or simply its text."""
