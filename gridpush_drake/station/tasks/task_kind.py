"""`TaskKind`: what `gridpush demo`, `robot` and `campaign` need to know of a kind of task.

It says in which scenario the task is done, when it is done, how a run is shown and recorded, which
files the run leaves in a folder (`write_files`), and how these are described and summarized. The
kinds there are stand in `station.schema.task_table`.
"""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

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
)
from gridpush_drake.display.server import write_recording
from gridpush_drake.files import write_whole
from gridpush_drake.identification.model_file import MODEL_FILE, write_model
from gridpush_drake.identification.result import Identification
from gridpush_drake.multibody.ground_truth import describe_truth
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import OBJECT_FILE
from gridpush_drake.pushes.push_csv import PUSHES_FILE
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.stream import write_stream_csv
from gridpush_drake.report.page import ReportSummary, make_report
from gridpush_drake.report.progress import ExpectedUncertainty, calc_progress
from gridpush_drake.station.scene.camera import calc_pose_age
from gridpush_drake.station.scene.resolve import ResolvedScenario, naming
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.schema.scenario_file import read_scenario, write_scenario
from gridpush_drake.station.tasks.task import OBSERVATION_PERIOD, StationTask, TaskStatus
from gridpush_drake.systems.base.messages import ContactPointStatus, PreGraspStatus, PushStatus
from gridpush_drake.systems.learning.estimate_visualizer import OBJECT_PATH
from gridpush_drake.yaml_file import dump_yaml

FRAMES_PER_SECOND = 20.0
"""Frames of the recording in a simulated second."""

BEFORE_LOOKING = (
    "The robot looks where the object lies. Colors and ellipse show what it supposes beforehand: "
    "an even object, of which little is known."
)
"""Text beside the scene until the first push."""

FIRST_TITLE = "Looking at the object"
"""Title above that text."""

FIRST_REASONS = (ContactPointStatus().reason, PreGraspStatus().reason)
"""Reasons in the controllers' statuses before they have seen anything."""

REPORT_FILE = "report.html"
RECORDING_FILE = "recording.html"
HELD_OUT = "held_out.csv"
STREAM_FILE = "stream.csv"
WEIGHINGS_FILE = "weighings.csv"
TRUTH_FILE = "truth.yaml"
SCENARIO_FILE = "scenario.yaml"
"""Names of the files that a run leaves in its folder, beside those of the object, the pushes and
the model, which have their names elsewhere."""

RUN_FILES = (
    REPORT_FILE,
    RECORDING_FILE,
    MODEL_FILE,
    OBJECT_FILE,
    PUSHES_FILE,
    HELD_OUT,
    WEIGHINGS_FILE,
    STREAM_FILE,
    TRUTH_FILE,
    SCENARIO_FILE,
)
"""Files that a run may leave, in the order in which they are listed to the user."""

Report = Callable[[str, str, int], None]
"""A function that is told what is being done, a detail that changes all the time, and the number of
steps done."""


class TaskKind:
    """A kind of task, as the commands know it.

    A `record` in its methods is what a run came to: a `TaskRecord` of the task's own kind.

    A kind overrides `describe_step`, `describe`, and either `make_summary` or `make_report`. Where
    the controller has an output port `status` and the record is a `ControlledRecord`, it overrides
    `name_phase`; elsewhere `describe_phase` and `list_phases`.

    Attributes:
        help: what the robot does, as the help of `--task` says it; it begins with a small letter
            and has no period.
        sentence: what the robot is to do, as an order; {} is the object's name.
        station: the class of the task, a `StationTask`, made of a scenario and a Meshcat.
        scenario: name of the shipped scenario in which the task is done if none is given; None for
            `PushScenario()`, an iiwa with a finger.
        done: status of a run in which all went well.
        has_goal: whether there is something to reach, so that a run may end without reaching it.
        left_out: those of `RUN_FILES` that no run of the task leaves.
        marks: entries of the recording's legend, besides those of the estimate.
        grasps: whether the robot needs a gripper.
        several: whether it is a task with several objects, of which the robot is told the outlines.
        looking: title and text beside the scene until the first push.
        hides: whether the arm hides the object from the camera again and again while it works.
        counts_pokes: whether the user may say how many pokes are learned from.
        weighs: whether it can be done with an object of which only the outline is known, as the
            robot weighs it on the way.
    """

    help: str
    sentence: str
    station: type[StationTask[Any]]
    scenario: str | None = None
    done: TaskStatus = TaskStatus.FINISHED
    has_goal: bool = True
    left_out: tuple[str, ...] = (HELD_OUT, WEIGHINGS_FILE)
    marks: tuple[Mark, ...] = ()
    grasps: bool = False
    several: bool = False
    looking: tuple[str, str] = (FIRST_TITLE, BEFORE_LOOKING)
    hides: bool = False
    counts_pokes: bool = False
    weighs: bool = False

    @property
    def needs_poses(self) -> bool:
        """Whether the robot is told the objects' poses unless a camera is asked for."""
        return self.several or self.hides

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the files that a run leaves in its folder, the report first.

        In a task with several objects there is a `MODEL_FILE` of each, see `list_files`.
        """
        return tuple(name for name in RUN_FILES if name not in self.left_out)

    def make_scenario(self) -> PushScenario:
        """Makes the scenario in which the task is done if none is given."""
        return PushScenario() if self.scenario is None else read_scenario(self.scenario)

    def list_files(self, resolved: ResolvedScenario) -> tuple[str, ...]:
        """Lists the names of the files that a run in a scenario may leave, the report first."""
        return place_models(self.files, self.list_model_files(resolved))

    def list_model_files(self, resolved: ResolvedScenario) -> tuple[str, ...]:
        """Lists the names of the files of the objects' models; here one."""
        return (MODEL_FILE,)

    def list_models(self, record: Any) -> dict[str, Identification]:
        """Lists what was learned of each object by the names of the models' files."""
        return {MODEL_FILE: record.estimates[-1]} if record.estimates else {}

    def check(self, resolved: ResolvedScenario, more: Sequence[str] = ()) -> None:
        """Checks that the task can be done in a scenario, before anything is made or opened.

        It tells what is known without a station; `make_task` may still refuse the scenario.

        Args:
            resolved: the scenario.
            more: further faults, which are told with those of the task.

        Raises:
            ScenarioError: it cannot; the message names the scenario's file and has all faults.
        """
        with naming(resolved.source):
            self.station.check(resolved, more)

    def make_task(self, resolved: ResolvedScenario, *given: Any, **more: Any) -> Any:
        """Makes the task, a `StationTask`, with what its class takes besides the scenario.

        Raises:
            ScenarioError: the task cannot be done in the scenario; the message names its file.
            PlanningError: a goal will not do; the message names the scenario's file.
        """
        with naming(resolved.source):
            return self.station(resolved, *given, **more)

    def run(
        self,
        resolved: ResolvedScenario,
        page: LivePage,
        realtime_rate: float,
        report: Report,
        watchers: Sequence[Callable[[Any], None]] = (),
    ) -> Any:
        """Runs the task, and records it from the moment when everything is set up.

        Args:
            resolved: the resolved scenario.
            page: the page that shows and records the run.
            realtime_rate: greatest number of simulated seconds in a second; 0 for as fast as
                possible.
            report: told after every step what is being done, for how long, and how far it is.
            watchers: called with the task after every step, such as `RunRecorder.note`.

        Returns:
            The record of the run.
        """
        task = self.make_task(resolved, page.meshcat)
        task.AimCamera(page.meshcat)
        page.overlay = self.make_overlay(task.list_objects())
        phases = [Phase(0.0, *self.looking)]
        page.show_phases(phases)

        def show(status: PushStatus, logged: int) -> None:
            for watch in watchers:
                watch(task)
            time = task.simulator.get_context().get_time()
            doing, steps = self.describe_step(task, status)
            report(doing, f"{time:.0f} s simulated", steps)
            phase = self.describe_phase(task, status, time)
            if phase is not None and not phase.says_the_same(phases[-1]):
                phases.append(phase)
                page.show_phases(phases)

        page.meshcat.StartRecording(FRAMES_PER_SECOND)
        return task.run(progress=show, realtime_rate=realtime_rate)

    def make_overlay(self, objects: Sequence[GridObject], phases: Sequence[Phase] = ()) -> Overlay:
        """Makes what stands beside the scene, in the live page and in the recording.

        Args:
            objects: the objects that are learned.
            phases: what was done from when on.
        """
        return Overlay(
            scale=make_color_scale(objects, CellColors()),
            marks=(*list_estimate_marks(), *self.marks),
            phases=tuple(phases),
            close_up=make_close_up(objects[0], OBJECT_PATH),
        )

    def count_steps(self, scenario: PushScenario) -> int:
        """Returns the number of steps at which the progress bar is full."""
        return 1

    def describe_step(self, task: Any, status: PushStatus) -> tuple[str, int]:
        """Says what is being done, and returns the number of steps done.

        Args:
            task: the task that runs.
            status: status of the executor of pushes.
        """
        raise NotImplementedError

    def name_phase(self, status: Any) -> str:
        """Returns the title beside the recording for a controller's status."""
        raise NotImplementedError

    def describe_phase(self, task: Any, status: PushStatus, time: float) -> Phase | None:
        """Describes what is being done, for the live page.

        Args:
            task: the task that runs.
            status: status of the executor of pushes.
            time: time now, s.

        Returns:
            The phase; None if nothing has been done yet.
        """
        now = task.read("status", task.controller)
        return self._make_phase(now, time)

    def list_phases(self, record: Any) -> list[Phase]:
        """Lists what the robot did when, for the recording: a phase for each controller's step."""
        phases = [Phase(0.0, *self.looking)]
        for step in record.steps:
            phase = self._make_phase(step.status, step.time)
            if phase is not None:
                phases.append(phase)
        return phases

    def _make_phase(self, status: Any, time: float) -> Phase | None:
        """Makes a phase of a controller's status; None if the controller has done nothing yet.

        A status is noted, at `time`, at the end of the `OBSERVATION_PERIOD` in which the controller
        took the step. Meshcat may have drawn what the step commands since the beginning of that
        interval, so the phase begins there: nothing is drawn before it is described.
        """
        if status.reason in FIRST_REASONS:
            return None
        return Phase(max(0.0, time - OBSERVATION_PERIOD), self.name_phase(status), status.reason)

    def split_log(self, record: Any) -> tuple[PushLog, PushLog]:
        """Splits the log into pushes to learn from and pushes held out; here none are held out."""
        return record.log, record.log[:0]

    def make_summary(self, record: Any) -> ReportSummary:
        """Makes the part of the report that shows the run."""
        raise NotImplementedError

    def list_expectations(self, record: Any) -> list[ExpectedUncertainty]:
        """Lists what pokes were expected to tell of the center of mass; here nothing."""
        return []

    def make_report(self, record: Any, recording: str | None = None) -> str:
        """Makes the report, as HTML, of the pushes from which the last estimate was learned.

        Args:
            record: the record of the run; it has an estimate.
            recording: path of the recording's file, relative to the report; None without one.
        """
        estimate = record.estimates[-1]
        used = record.log.subset(
            [i for i, seen in enumerate(record.log) if seen.name in estimate.push_names]
        )
        return make_report(
            estimate,
            used,
            truth=record.truth,
            summary=self.make_summary(record),
            camera_view=record.camera_view,
            progress=calc_progress(record.estimates, record.log, record.truth),
            expectations=self.list_expectations(record),
            recording=recording,
        )

    def write_own(self, folder: Path, record: Any, recording: str | None, force: bool) -> list[str]:
        """Writes files that only this kind of task leaves; here none.

        Args:
            folder: folder in which they are written.
            record: the record of the run.
            recording: name of the recording's file in it; None without one.
            force: whether existing files may be replaced.

        Returns:
            The files' names.
        """
        return []

    def summarize(self, record: Any) -> dict[str, Any]:
        """Summarizes a run in SI units, for JSON; "done" tells if the robot reached its goal."""
        limits = record.limit_report
        summary: dict[str, Any] = {"object": record.obj.name, "status": record.status}
        if self.has_goal:
            summary["done"] = record.status == self.done
        return summary | {
            "message": record.message,
            "simulated_seconds": record.duration,
            "limit_report": vars(limits) | {"touched": sorted(map(list, limits.touched))},
        }

    def count_made(self, record: Any) -> dict[str, Any]:
        """Counts for a campaign what was made: fields of `EpisodeOutcome`; here the pushes."""
        return {"pushes": len(record.log)}

    def describe(self, summary: dict[str, Any]) -> list[str]:
        """Describes a summary in lines of words."""
        raise NotImplementedError


class GoalKind(TaskKind):
    """A kind of task in which at most `goal.max_pushes` pushes bring objects to their places."""

    def count_steps(self, scenario: PushScenario) -> int:
        """Counts the pushes that may be made."""
        return scenario.goal.max_pushes

    def describe_step(self, task: Any, status: PushStatus) -> tuple[str, int]:
        """Names the push that is being made."""
        return f"push {status.executed + (not status.ready)}, {status.phase}", status.executed


def place_models(files: Sequence[str], models: Iterable[str]) -> tuple[str, ...]:
    """Puts the names of models' files in the place of `MODEL_FILE` in the names of all files."""
    named = tuple(models)
    return tuple(each for name in files for each in (named if name == MODEL_FILE else (name,)))


def write_files(
    task: TaskKind,
    folder: Path,
    scenario: PushScenario,
    record: Any,
    meshcat: Meshcat | None,
    force: bool,
) -> list[Path]:
    """Writes the files of a run.

    The models are the station's own. `gridpush identify` makes the same of object.yaml, pushes.csv
    and, if the object was weighed, weighings.csv.

    Args:
        task: kind of the task.
        folder: folder in which the files are written.
        scenario: the scenario of the run.
        record: the record of the run.
        meshcat: Meshcat with the recording; None to write no recording.
        force: whether existing files may be replaced.

    Returns:
        The files, in the order of `task.files`, without those for which the run was too short.

    Raises:
        OutputError: a file exists and `force` is not set, or it cannot be written.
    """
    obj = record.obj
    written = {OBJECT_FILE, STREAM_FILE, SCENARIO_FILE}
    overlay = task.make_overlay(record.list_objects(), task.list_phases(record))
    if meshcat is not None:
        write_recording(meshcat, folder / RECORDING_FILE, force, overlay)
        written.add(RECORDING_FILE)
    obj.write_yaml(folder / OBJECT_FILE, force=force)
    if record.truth is not None:
        write_whole(folder / TRUTH_FILE, dump_yaml(describe_truth(obj, record.truth)), force)
        written.add(TRUTH_FILE)
    write_scenario(folder / SCENARIO_FILE, scenario, force)
    write_stream_csv(record.stream, folder / STREAM_FILE, force, calc_pose_age(scenario.camera))

    recording = RECORDING_FILE if meshcat is not None else None
    written.update(task.write_own(folder, record, recording, force))

    # Models and report need an estimate, which there is after the first push.
    models = task.list_models(record)
    for name, model in models.items():
        write_model(folder / name, model, force)
        written.add(name)
    training, held_out = task.split_log(record)
    if record.estimates:
        training.write_csv(folder / PUSHES_FILE, force)
        write_whole(folder / REPORT_FILE, task.make_report(record, recording), force)
        written |= {PUSHES_FILE, REPORT_FILE}
    if len(held_out):
        held_out.write_csv(folder / HELD_OUT, force)
        written.add(HELD_OUT)
    if len(record.weighings):
        record.weighings.write_csv(folder / WEIGHINGS_FILE, force)
        written.add(WEIGHINGS_FILE)
    return [folder / name for name in place_models(task.files, models) if name in written]
