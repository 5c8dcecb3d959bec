"""The demo's whole story: poke the object, learn it, slide it to the table's edge, grasp what hangs over, lift it."""

from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat

from gridpush_drake.cli.console import MM, count_progress, print_line
from gridpush_drake.cli.demo_files import describe_limit_report, make_overlay, write_learned, write_setting
from gridpush_drake.cli.demo_task import FRAMES_A_SECOND, DemoTask, describe_time
from gridpush_drake.multibody.parser import find_models
from gridpush_drake.multibody.recording_overlay import Phase
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.pregrasp.uncertainty import UncertainModel
from gridpush_drake.report.page import ReportSummary
from gridpush_drake.report.pregrasp_figure import GraspDrawn, PushDrawn, draw_pre_grasp
from gridpush_drake.station.pregrasp_task import HELD, PreGraspRecord, PreGraspStep, PreGraspTask
from gridpush_drake.station.scenario import PushScenario, read_scenario
from gridpush_drake.systems.messages import PreGraspMode, PushStatus

FILES = ("report.html", "recording.html", "model.yaml", "object.yaml", "pushes.csv", "truth.yaml", "scenario.yaml")

SCENARIO = "scenarios/grasp.yaml"
"""Among the shipped models."""

HEADS = ("time", "what", "why")

TITLES = {
    PreGraspMode.WAITING: "Looking at the object",
    PreGraspMode.EXPLORING: "Poke{}, to learn where the mass is",
    PreGraspMode.SLIDING: "Slide{}, toward the table's edge",
    PreGraspMode.STOPPING: "Breaking off the push",
    PreGraspMode.VERIFYING: "Checking that it can be grasped here",
    PreGraspMode.GRASPING: "Grasping and lifting",
    PreGraspMode.HOLDING: "Lifted and held",
    PreGraspMode.LOST: "The object is out of sight",
    PreGraspMode.FAILED: "Given up",
}
"""Of the controller's modes, beside the recording; {} is the push's number."""


def make_scenario() -> PushScenario:
    """The shipped scenario of a robot that can grasp."""
    return read_scenario(find_models() / SCENARIO)


def run(scenario: PushScenario, meshcat: Meshcat, realtime_rate: float) -> PreGraspRecord:
    """Runs the task."""
    task = PreGraspTask(scenario, meshcat)
    task.AimCamera(meshcat)
    with count_progress("the robot", 1) as report:

        def show(status: PushStatus, logged: int) -> None:
            now = task.task.read("status", task.controller)
            did = f"{_count(now.pokes, 'poke')} and {_count(now.slides, 'slide')}"
            report(f"{now.mode}, {did}", describe_time(task.task.simulator), int(now.over))

        meshcat.StartRecording(FRAMES_A_SECOND)
        return task.run(progress=show, realtime_rate=realtime_rate)


def write(folder: Path, scenario: PushScenario, record: PreGraspRecord, meshcat: Meshcat, force: bool) -> list[Path]:
    """Writes what a run came to.

    Args:
        folder: where; it exists.
        scenario: of the run.
        record: of the run; what it was too short for is not written.
        meshcat: with its recording.
        force: whether existing files may be replaced.

    Returns:
        The files written, in the order of FILES.
    """
    overlay = make_overlay(record.obj, [_describe_phase(step) for step in record.steps])
    written = write_setting(folder, scenario, record.obj, record.truth, meshcat, overlay, force)
    if record.estimates:
        written += write_learned(
            folder, record.log, record.estimates[-1], record.truth, make_report_summary(record), force
        )
    return [folder / name for name in FILES if folder / name in written]


def judge(record: PreGraspRecord) -> dict[str, Any]:
    """What came of it, lengths in m; for JSON."""
    last = record.last
    verdict: dict[str, Any] = {
        "object": record.obj.name,
        "status": record.status,
        "done": record.status == HELD,
        "message": record.message,
        "pokes": last.pokes,
        "slides": last.slides,
        "grasps": last.grasps,
        "raised": record.raised,
        "simulated_seconds": record.duration,
        "limit_report": describe_limit_report(record.limit_report),
    }
    if record.estimates:
        found, truth = record.estimates[-1], record.truth.center_of_mass(record.obj)
        for name, params in (("before", CellParameters.uniform(record.obj)), ("after", found.params)):
            error = float(np.linalg.norm(params.center_of_mass(record.obj) - truth))
            verdict[name] = {"center_of_mass_error": error}
    return verdict


def tell(verdict: dict[str, Any], written: list[Path]) -> None:
    """Prints a verdict, and what was written."""
    name = verdict["object"].replace("_", " ")
    print_line(f"The {name} after {verdict['pokes']} pokes and {verdict['slides']} slides: {verdict['message']}")
    if "after" in verdict:
        before, after = (verdict[key]["center_of_mass_error"] * MM for key in ("before", "after"))
        print_line(f"  error of the center of mass: {before:.1f} mm assuming an even object, {after:.1f} mm as learned")
    print_line(f"\nIn {written[0].parent}: {', '.join(path.name for path in written)}.")


def make_report_summary(record: PreGraspRecord) -> ReportSummary:
    """The run for the report's head."""
    last = record.last
    uncertain = UncertainModel.of_identification(record.estimates[-1])
    poses = [step.pose for step in record.steps if np.isfinite(step.pose).all() and not step.status.over]
    pushes = [
        PushDrawn(step.push.start, step.push.end, step.status.mode == PreGraspMode.EXPLORING)
        for step in record.steps
        if step.push is not None
    ]
    grasp = next((step.grasp for step in reversed(record.steps) if step.grasp is not None), None)
    drawn = None if grasp is None else GraspDrawn(np.array([grasp.x, grasp.y]), grasp.approach)
    return ReportSummary(
        verdict=f"{record.message} It took {_count(last.pokes, 'poke')} and {_count(last.slides, 'slide')}.",
        facts=(
            ("pokes", str(last.pokes)),
            ("slides", str(last.slides)),
            ("simulated", f"{record.duration:.0f} s"),
            ("raised by", f"{record.raised * MM:.0f} mm"),
        ),
        figure=draw_pre_grasp(record.obj, record.surface, poses, pushes, uncertain.masses, record.truth, drawn),
        caption="Left: pokes to learn, then slides to the table's edge. Right: as long as its center of mass is within "
        "what holds the object it stays put; it was judged on every place where the center of mass may still be.",
        heads=HEADS,
        steps=[_describe(step) for step in record.steps if step.status.mode != PreGraspMode.WAITING],
    )


def _describe_phase(step: PreGraspStep) -> Phase:
    status = step.status
    numbers = {PreGraspMode.EXPLORING: f" {status.pokes}", PreGraspMode.SLIDING: f" {status.slides}"}
    return Phase(step.time, TITLES[status.mode].format(numbers.get(status.mode, "")), status.reason)


def _describe(step: PreGraspStep) -> tuple[str, str, str]:
    return f"{step.time:.1f}\N{NO-BREAK SPACE}s", step.status.mode, step.status.reason


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


TASK = DemoTask(FILES, make_scenario, run, write, judge, tell)
"""As the demo uses it."""
