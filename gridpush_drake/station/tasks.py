"""The one registry of tasks in the station, for `gridpush demo`, `robot` and `campaign`.

Of each: how it is made, in which scenario, when it is done, what its run leaves in a folder, and
how that is described and summarized. A task of your own is one more name in `TaskName`, and one more
`TaskKind` in `TASKS`.
"""

from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat

from gridpush_drake.display.cell_colors import CellColors
from gridpush_drake.display.live_page import LivePage
from gridpush_drake.display.overlay import (
    Mark,
    Overlay,
    Phase,
    list_estimate_marks,
    make_close_up,
    make_color_scale,
    to_css,
)
from gridpush_drake.display.server import write_recording
from gridpush_drake.files import write_whole
from gridpush_drake.identification.learning import describe_prior
from gridpush_drake.identification.model_file import write_model
from gridpush_drake.identification.prediction import calc_mean_cell_error
from gridpush_drake.multibody.ground_truth import describe_truth
from gridpush_drake.notebook import MM
from gridpush_drake.notebook import count as count_noun
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.pregrasp.uncertainty import UncertainModel
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.stream import write_stream_csv
from gridpush_drake.report.page import ReportSummary, make_report
from gridpush_drake.report.plan_figures import GraspDrawn, PushDrawn, draw_pre_grasp, draw_push_run
from gridpush_drake.report.progress import Expectation, calc_progress
from gridpush_drake.station.camera import calc_pose_age
from gridpush_drake.station.identify_task import IdentifyTask, IdentifyTaskRecord
from gridpush_drake.station.pregrasp_task import PreGraspRecord, PreGraspTask
from gridpush_drake.station.push_task import GOAL_COLOR, PushTask, PushTaskRecord
from gridpush_drake.station.resolve import ResolvedScenario
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.scenario_file import read_scenario, write_scenario
from gridpush_drake.station.task import ADVANCE, TaskRecord, TaskStatus
from gridpush_drake.systems.estimate_visualizer import OBJECT_PATH
from gridpush_drake.systems.messages import (
    ContactPointMode,
    ContactPointStatus,
    PreGraspMode,
    PreGraspStatus,
    PushStatus,
)
from gridpush_drake.yaml_file import dump_yaml

FRAMES_PER_SECOND = 20.0
"""Of the recording."""

BEFORE_LOOKING = (
    "The robot looks where the object lies. Colors and ellipse show what it supposes beforehand: "
    "an even object, of which little is known."
)
"""Said beside the scene until the first push."""

FIRST_TITLE = "Looking at the object"

FIRST_REASONS = (ContactPointStatus().reason, PreGraspStatus().reason)
"""What the controllers say before they have seen anything."""

FILES = (
    "report.html", "recording.html", "model.yaml", "object.yaml", "pushes.csv", "stream.csv", "truth.yaml",
    "scenario.yaml",
)  # fmt: skip
"""That a task leaves in its folder, the report first."""

HELD_OUT = "held_out.csv"

RECORDING = "recording.html"
"""Name of the recording's file, beside the report."""

GRASP_SCENARIO = "grasp"
"""Name of the shipped scenario of the pre-grasp task."""

PUSH_TITLES = {
    ContactPointMode.WAITING: FIRST_TITLE,
    ContactPointMode.PUSHING: "Push {}, toward the goal",
    ContactPointMode.REACHED: "At the goal",
    ContactPointMode.FAILED: "Given up",
    ContactPointMode.LOST: "The object is out of sight",
}
"""Of the controller's modes, beside the recording; {} is the push's number."""

PREGRASP_TITLES = {
    PreGraspMode.WAITING: FIRST_TITLE,
    PreGraspMode.EXPLORING: "Poke {status.pokes}, to learn where the mass is",
    PreGraspMode.SLIDING: "Slide {status.slides}, toward the table's edge",
    PreGraspMode.STOPPING: "Breaking off the push",
    PreGraspMode.VERIFYING: "Checking that it can be grasped here",
    PreGraspMode.GRASPING: "Grasping and lifting",
    PreGraspMode.HOLDING: "Lifted and held",
    PreGraspMode.LOST: "The object is out of sight",
    PreGraspMode.FAILED: "Given up",
}
"""Likewise; `status` is the controller's."""


Report = Callable[[str, str, int], None]
"""Told what is being done, a detail that changes all the time, and how far the count is."""


class TaskName(StrEnum):
    """What the robot is to do, as `--task` names it on the command line."""

    identify = "identify"
    push = "push"
    pregrasp = "pregrasp"


class TaskKind:
    """A task of the demo. `record` is what its run came to: a `TaskRecord` of its own kind.

    Attributes:
        station: the kind of task that the robot does.
        scenario: name of the shipped scenario that it has by itself; None for an iiwa with a finger.
        done: status of a run in which all went well.
        has_goal: whether there is something to reach, so that a run may end without it.
        files: that it leaves in its folder, the report first.
        marks: of the recording's legend, besides the estimate's.
    """

    station: Callable[..., Any]
    scenario: str | None = None
    done: TaskStatus = TaskStatus.FINISHED
    has_goal: bool = True
    files: tuple[str, ...] = FILES
    marks: tuple[Mark, ...] = ()

    def make_scenario(self) -> PushScenario:
        """The scenario that it has by itself."""
        return PushScenario() if self.scenario is None else read_scenario(self.scenario)

    def run(
        self, resolved: ResolvedScenario, page: LivePage, realtime_rate: float, report: Report
    ) -> Any:
        """Runs the task and records it from the moment when all is set up; returns the record.

        Args:
            resolved: what stands where.
            page: to show and record it on.
            realtime_rate: at most so many simulated seconds a second; 0 for as fast as possible.
            report: told after every step what is being done, for how long, and how far the count is.
        """
        task = self.station(resolved, page.meshcat)
        task.AimCamera(page.meshcat)
        page.overlay = self.make_overlay(task.station.obj)
        phases = [Phase(0.0, FIRST_TITLE, BEFORE_LOOKING)]
        page.show_phases(phases)

        def show(status: PushStatus, logged: int) -> None:
            time = task.simulator.get_context().get_time()
            doing, steps = self.describe_step(task, status)
            report(doing, f"{time:.0f} s simulated", steps)
            now = self.describe_phase(task, status, time)
            if now is not None and not now.says_the_same(phases[-1]):
                phases.append(now)
                page.show_phases(phases)

        page.meshcat.StartRecording(FRAMES_PER_SECOND)
        return task.run(progress=show, realtime_rate=realtime_rate)

    def make_overlay(self, obj: GridObject, phases: Sequence[Phase] = ()) -> Overlay:
        """What stands beside the scene, live and in the recording."""
        return Overlay(
            scale=make_color_scale(obj, CellColors()),
            marks=(*list_estimate_marks(), *self.marks),
            phases=tuple(phases),
            close_up=make_close_up(obj, OBJECT_PATH),
        )

    def count_steps(self, scenario: PushScenario) -> int:
        """How many steps the progress counts to."""
        return 1

    def describe_step(self, task: Any, status: PushStatus) -> tuple[str, int]:
        """What is being done, by the push executor's status, and how far the count is."""
        raise NotImplementedError

    def name_phase(self, status: Any) -> str:
        """What a controller's step is called beside the recording."""
        raise NotImplementedError

    def describe_phase(self, task: Any, status: PushStatus, time: float) -> Phase | None:
        """What is being done at a time, s, for the live page; None where that is not new."""
        now = task.read("status", task.controller)
        return self._make_phase(now, time)

    def list_phases(self, record: Any) -> list[Phase]:
        """What the robot did when, for the recording: a phase a step of the controller."""
        phases = [Phase(0.0, FIRST_TITLE, BEFORE_LOOKING)]
        for step in record.steps:
            phase = self._make_phase(step.status, step.time)
            if phase is not None:
                phases.append(phase)
        return phases

    def _make_phase(self, status: Any, time: float) -> Phase | None:
        """A controller's step, noted at a time, s, as a phase; None where it has done nothing yet.

        A step is noted at the end of the ADVANCE in which it was taken, and what it commands may be
        drawn since the beginning of that: the phase begins there, so that nothing is drawn early.
        """
        if status.reason in FIRST_REASONS:
            return None
        return Phase(max(0.0, time - ADVANCE), self.name_phase(status), status.reason)

    def split_log(self, record: Any) -> tuple[PushLog, PushLog]:
        """The pushes to learn from and those held out: none."""
        return record.log, record.log[:0]

    def make_summary(self, record: Any) -> ReportSummary:
        """What the report shows of the run."""
        raise NotImplementedError

    def list_expectations(self, record: Any) -> list[Expectation]:
        """What pokes were expected to tell of the center of mass: nothing."""
        return []

    def make_report(self, record: Any, recording: str | None = None) -> str:
        """The report, as HTML, of the pushes that the last estimate was learned from; the record has one.

        `recording` is the recording's file as seen from the report; None without.
        """
        found = record.estimates[-1]
        used = record.log.subset(
            [i for i, seen in enumerate(record.log) if seen.name in found.push_names]
        )
        return make_report(
            found,
            used,
            truth=record.truth,
            summary=self.make_summary(record),
            sight=record.sight,
            progress=calc_progress(record.estimates, record.log, record.truth),
            expectations=self.list_expectations(record),
            recording=recording,
        )

    def summarize(self, record: Any) -> dict[str, Any]:
        """What came of it, in SI units, for JSON; "done": whether the robot got there."""
        limits = record.limit_report
        return {
            "object": record.obj.name,
            "status": record.status,
            **({"done": record.status == self.done} if self.has_goal else {}),
            "message": record.message,
            "simulated_seconds": record.duration,
            "limit_report": vars(limits) | {"touched": sorted(map(list, limits.touched))},
        }

    def describe(self, summary: dict[str, Any]) -> list[str]:
        """A summary in lines of words."""
        raise NotImplementedError


def write_files(
    task: TaskKind,
    folder: Path,
    scenario: PushScenario,
    record: Any,
    meshcat: Meshcat | None,
    force: bool,
) -> list[Path]:
    """Writes what a run came to, and gives the files in the order of the task's; not what it was too short for.

    The model is the station's own: that which `gridpush identify` makes of object.yaml and
    pushes.csv. Without Meshcat, there is no recording.

    Raises:
        OutputError: a file exists and `force` is not set, or it cannot be written.
    """
    obj = record.obj
    overlay = task.make_overlay(obj, task.list_phases(record))
    written = {"object.yaml", "stream.csv", "scenario.yaml"}
    if meshcat is not None:
        write_recording(meshcat, folder / RECORDING, force, overlay)
        written.add(RECORDING)
    obj.write_yaml(folder / "object.yaml", force=force)
    if record.truth is not None:
        truth = dump_yaml(describe_truth(obj, record.truth))
        write_whole(folder / "truth.yaml", truth, force)
        written.add("truth.yaml")
    write_scenario(folder / "scenario.yaml", scenario, force)
    write_stream_csv(record.stream, folder / "stream.csv", force, calc_pose_age(scenario.camera))
    training, held_out = task.split_log(record)
    if record.estimates:
        training.write_csv(folder / "pushes.csv", force)
        write_model(folder / "model.yaml", record.estimates[-1], force)
        recording = RECORDING if meshcat is not None else None
        write_whole(folder / "report.html", task.make_report(record, recording), force)
        written |= {"pushes.csv", "model.yaml", "report.html"}
    if len(held_out):
        held_out.write_csv(folder / HELD_OUT, force)
        written.add(HELD_OUT)
    return [folder / name for name in task.files if name in written]


class IdentifyKind(TaskKind):
    """A robot pokes an object it knows nothing about, and comes to know it."""

    station, has_goal = IdentifyTask, False
    files = (*FILES[:5], HELD_OUT, *FILES[5:])

    def count_steps(self, scenario: PushScenario) -> int:
        """Pushes to learn from, and those held out."""
        return scenario.pokes.count + scenario.pokes.test_count

    def describe_step(self, task: Any, status: PushStatus) -> tuple[str, int]:
        """The push that is being made."""
        total, refused = self.count_steps(task.station.scenario), ""
        kind = "push" if status.executed < task.station.scenario.pokes.count else "held-out push"
        if status.reason:
            refused = f" (refused {status.refused}: {status.reason})"
        return (
            f"{kind} {min(status.executed + 1, total)} of {total}, {status.phase}{refused}",
            status.executed,
        )

    def list_phases(self, record: IdentifyTaskRecord) -> list[Phase]:
        """Pushes to learn from, then pushes to test."""
        return [self._name_push(status, time, record.training) for time, status in record.phases]

    def describe_phase(self, task: Any, status: PushStatus, time: float) -> Phase | None:
        """What the push executor does."""
        return self._name_push(status, time, task.station.scenario.pokes.count)

    def _name_push(self, status: PushStatus, time: float, training: int) -> Phase:
        """A status of the push executor as a phase; the first `training` pushes are learned from."""
        count = status.executed + (not status.ready)
        if status.ready and not count:
            return Phase(0.0, FIRST_TITLE, BEFORE_LOOKING)
        kind = "Push" if count <= training else "Held-out push"
        title = FIRST_TITLE if status.ready else f"{kind} {count}: {status.phase}"
        detail = "" if count <= training else "Predicted only, to test what was learned."
        return Phase(max(0.0, time - ADVANCE), title, detail)

    def split_log(self, record: IdentifyTaskRecord) -> tuple[PushLog, PushLog]:
        """By the scenario's counts."""
        return record.training_log, record.held_out_log

    def make_report(self, record: IdentifyTaskRecord, recording: str | None = None) -> str:
        """How the error of the held-out pushes fell, push by push."""
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
            calc_mean_cell_error(record.obj, found.params, held_out, result.physics)
            for found in (describe_prior(record.obj), *record.estimates)
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
        """Errors before and after learning, and how the robot behaved."""
        counts = {"pushes": len(record.training_log), "held_out": len(record.held_out_log)}
        summary = super().summarize(record) | counts
        if record.estimates:
            summary["learned"] = record.estimates[-1].message
            found, centers = record.estimates[-1], _calc_center_errors(record)
            for name, params in (
                ("before", CellParameters.uniform(record.obj)),
                ("after", found.params),
            ):
                held_out = calc_mean_cell_error(
                    record.obj, params, record.held_out_log, found.physics
                )
                summary[name] = {"held_out_cell_error": held_out}
                if centers:
                    summary[name]["center_of_mass_error"] = centers[name]
        return summary

    def describe(self, summary: dict[str, Any]) -> list[str]:
        """Errors before and after learning."""
        name = summary["object"].replace("_", " ")
        lines = [summary["message"]] if summary["status"] != TaskStatus.FINISHED else []
        if "after" not in summary:
            return [*lines, f"Nothing was learned about the {name}."]
        lines.append(f"The {name} after {summary['pushes']} pushes: {summary['learned']}")
        if summary["held_out"]:
            lines.append(
                _compare(
                    f"error of {summary['held_out']} pushes held out",
                    "held_out_cell_error",
                    summary,
                )
            )
        if "center_of_mass_error" in summary["after"]:
            lines.append(_compare("error of the center of mass", "center_of_mass_error", summary))
        return lines


class PushKind(TaskKind):
    """A robot pushes an object it knows nothing about to a goal, and learns it on the way."""

    station, done = PushTask, TaskStatus.REACHED
    marks = (Mark(to_css(GOAL_COLOR), "where the object should lie"),)

    def count_steps(self, scenario: PushScenario) -> int:
        """As many pushes as may be made."""
        return scenario.goal.max_pushes

    def describe_step(self, task: Any, status: PushStatus) -> tuple[str, int]:
        """The push that is being made."""
        return f"push {status.executed + (not status.ready)}, {status.phase}", status.executed

    def name_phase(self, status: Any) -> str:
        """A phase a push."""
        return PUSH_TITLES[status.mode].format(status.pushes + 1)

    def summarize(self, record: PushTaskRecord) -> dict[str, Any]:
        """How far from the goal it ended."""
        goal = [float(value) for value in record.goal]
        return super().summarize(record) | {
            "pushes": record.pushes,
            "goal": goal,
            "error": record.error,
        }

    def describe(self, summary: dict[str, Any]) -> list[str]:
        """How far from the goal it ended."""
        return [
            f"The {summary['object'].replace('_', ' ')} after {summary['pushes']} pushes: {summary['message']}",
            f"  mean distance of its cells from where they should be: {summary['error'] * MM:.1f} mm",
        ]

    def make_summary(self, record: PushTaskRecord) -> ReportSummary:
        """Where the object lay after every push."""
        steps = []
        for count, (seen, pose) in enumerate(
            zip(record.log, record.rest_poses[1:], strict=False), start=1
        ):
            x, y = seen.push.start.tolist()
            left = float(calc_goal_error(record.obj, pose, record.goal)) * MM
            steps.append(
                (
                    str(count),
                    f"({x:.3f}, {y:.3f}) m, {seen.push.length * MM:.0f} mm far",
                    f"{left:.0f} mm",
                )
            )
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
            caption="The object at rest after every push, the pushes as arrows, the goal dotted; and how far off it "
            "was.",
            heads=("push", "from", "left to go"),
            steps=steps,
        )


class PreGraspKind(TaskKind):
    """A robot pokes an object, learns it, slides it to the table's edge, grasps what hangs over, and lifts it."""

    station, done, scenario = PreGraspTask, TaskStatus.HELD, GRASP_SCENARIO

    def describe_step(self, task: Any, status: PushStatus) -> tuple[str, int]:
        """What the controller is at."""
        now = task.read("status", task.controller)
        return f"{now.mode}, {_count_pushes(now.pokes, now.slides)}", int(now.over)

    def name_phase(self, status: Any) -> str:
        """A phase a step of the controller."""
        return PREGRASP_TITLES[status.mode].format(status=status)

    def summarize(self, record: PreGraspRecord) -> dict[str, Any]:
        """Whether the object was lifted, and how well its center of mass was known."""
        last = record.last
        summary = super().summarize(record)
        summary |= {
            "pokes": last.pokes,
            "slides": last.slides,
            "grasps": last.grasps,
            "raised": record.raised,
        }
        if record.estimates:
            errors = _calc_center_errors(record)
            summary |= {name: {"center_of_mass_error": error} for name, error in errors.items()}
        return summary

    def describe(self, summary: dict[str, Any]) -> list[str]:
        """Whether the object was lifted, and how well its center of mass was known."""
        name = summary["object"].replace("_", " ")
        lines = [
            f"The {name} after {_count_pushes(summary['pokes'], summary['slides'])}: {summary['message']}"
        ]
        if "after" in summary:
            lines.append(_compare("error of the center of mass", "center_of_mass_error", summary))
        return lines

    def list_expectations(self, record: PreGraspRecord) -> list[Expectation]:
        """What each poke was expected to leave, where that was about the center of mass itself."""
        found = []
        for step in record.steps:
            status, forecast = step.status, step.status.forecast
            if step.push is None or status.mode != PreGraspMode.EXPLORING or forecast is None:
                continue
            if not forecast.across_edge:
                found.append(Expectation(status.pokes + status.slides, forecast.expected_std))
        return found

    def make_summary(self, record: PreGraspRecord) -> ReportSummary:
        """The object's trajectory to the edge, and how safely it lies there."""
        last = record.last
        masses = UncertainModel.of_identification(record.estimates[-1], log=record.log).masses
        poses = [
            step.pose
            for step in record.steps
            if np.isfinite(step.pose).all() and not step.status.over
        ]
        pushes = [
            PushDrawn(step.push.start, step.push.end, step.status.mode == PreGraspMode.EXPLORING)
            for step in record.steps
            if step.push is not None
        ]
        grasp = next(
            (step.grasp for step in reversed(record.steps) if step.grasp is not None), None
        )
        drawn = None if grasp is None else GraspDrawn(np.array([grasp.x, grasp.y]), grasp.approach)
        return ReportSummary(
            headline=f"{record.message} It took {_count_pushes(last.pokes, last.slides)}.",
            facts=(
                ("pokes", str(last.pokes)),
                ("slides", str(last.slides)),
                ("simulated", f"{record.duration:.0f} s"),
                (
                    "raised by",
                    f"{record.raised * MM:.0f} mm"
                    if np.isfinite(record.raised)
                    else "not measured",
                ),
            ),
            figure=draw_pre_grasp(
                record.obj, record.surface, poses, pushes, masses, record.truth, drawn
            ),
            caption="Left: pokes to learn, then slides to the table's edge. Right: as long as its center of mass is "
            "within what holds the object it stays put; it was judged on every place where the center of mass may "
            "still be.",
            heads=("time", "what", "why"),
            steps=[
                (f"{step.time:.1f}\N{NO-BREAK SPACE}s", step.status.mode, step.status.reason)
                for step in record.steps
                if step.status.mode != PreGraspMode.WAITING
            ],
        )


TASKS: dict[str, TaskKind] = {
    TaskName.identify: IdentifyKind(),
    TaskName.push: PushKind(),
    TaskName.pregrasp: PreGraspKind(),
}
"""The tasks by their names. A name is a `TaskName`, or simply its text."""


def calc_center_error(record: TaskRecord, params: CellParameters) -> float:
    """Distance of an estimate's center of mass from the true one, m."""
    assert record.truth is not None  # a simulated object's is known
    found, truth = (each.center_of_mass(record.obj) for each in (params, record.truth))
    return float(np.linalg.norm(found - truth))


def _calc_center_errors(record: Any) -> dict[str, float]:
    """Distance of the center of mass from the true one, m, "before", assuming an even object, and "after"; or {}."""
    compared = {"before": CellParameters.uniform(record.obj), "after": record.estimates[-1].params}
    known = {} if record.truth is None else compared
    return {name: calc_center_error(record, params) for name, params in known.items()}


def _compare(what: str, key: str, summary: dict[str, Any]) -> str:
    before, after = (summary[when][key] * MM for when in ("before", "after"))
    return f"  {what}: {before:.1f} mm assuming an even object, {after:.1f} mm as learned"


def _count_pushes(pokes: int, slides: int) -> str:
    return f"{count_noun(pokes, 'poke')} and {count_noun(slides, 'slide')}"
