"""The demo's second task: a robot pushes an object it knows nothing about to a goal, and learns it on the way."""

from pathlib import Path
from typing import Any

from pydrake.geometry import Meshcat

from gridpush_drake.cli.console import MM, count_progress, print_line
from gridpush_drake.cli.demo_files import describe_limit_report, make_overlay, write_learned, write_setting
from gridpush_drake.cli.demo_task import FRAMES_A_SECOND, DemoTask, describe_time
from gridpush_drake.cli.recording_legend import to_css
from gridpush_drake.multibody.recording_overlay import Mark, Phase
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.report.page import ReportSummary
from gridpush_drake.report.push_figure import draw_push_run
from gridpush_drake.station.push_task import GOAL_COLOR, PushTask, PushTaskRecord, PushTaskStep
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.systems.messages import ContactPointMode, PushStatus

FILES = ("report.html", "recording.html", "model.yaml", "object.yaml", "pushes.csv", "truth.yaml", "scenario.yaml")

REACHED = "reached"

HEADS = ("push", "from", "left to go")

TITLES = {
    ContactPointMode.WAITING: "Looking at the object",
    ContactPointMode.PUSHING: "Push{}, toward the goal",
    ContactPointMode.REACHED: "At the goal",
    ContactPointMode.FAILED: "Given up",
    ContactPointMode.LOST: "The object is out of sight",
}
"""Of the controller's modes, beside the recording; {} is the push's number."""


def run(scenario: PushScenario, meshcat: Meshcat, realtime_rate: float) -> PushTaskRecord:
    """Runs the task."""
    task = PushTask(scenario, meshcat)
    task.AimCamera(meshcat)
    with count_progress("the robot", scenario.goal.max_pushes) as report:

        def show(status: PushStatus, logged: int) -> None:
            doing = f"push {status.executed + (not status.ready)}, {status.phase}"
            report(doing, describe_time(task.simulator), status.executed)

        meshcat.StartRecording(FRAMES_A_SECOND)
        return task.run(progress=show, realtime_rate=realtime_rate)


def write(folder: Path, scenario: PushScenario, record: PushTaskRecord, meshcat: Meshcat, force: bool) -> list[Path]:
    """Writes what a run came to; see `demo_pre_grasp.write`."""
    goal = Mark(to_css(GOAL_COLOR), "where the object should lie")
    overlay = make_overlay(record.obj, [_describe_phase(step) for step in record.steps], [goal])
    written = write_setting(folder, scenario, record.obj, record.truth, meshcat, overlay, force)
    if record.estimates:
        written += write_learned(
            folder, record.log, record.estimates[-1], record.truth, make_report_summary(record), force
        )
    return [folder / name for name in FILES if folder / name in written]


def _describe_phase(step: PushTaskStep) -> Phase:
    status = step.status
    return Phase(step.time, TITLES[status.mode].format(f" {status.pushes + 1}"), status.reason)


def judge(record: PushTaskRecord) -> dict[str, Any]:
    """What came of it, lengths in m; for JSON."""
    return {
        "object": record.obj.name,
        "status": record.status,
        "done": record.status == REACHED,
        "message": record.message,
        "pushes": record.pushes,
        "goal": [float(value) for value in record.goal],
        "error": record.error,
        "simulated_seconds": record.duration,
        "limit_report": describe_limit_report(record.limit_report),
    }


def tell(verdict: dict[str, Any], written: list[Path]) -> None:
    """Prints a verdict, and what was written."""
    name = verdict["object"].replace("_", " ")
    print_line(f"The {name} after {verdict['pushes']} pushes: {verdict['message']}")
    print_line(f"  mean distance of its cells from where they should be: {verdict['error'] * MM:.1f} mm")
    print_line(f"\nIn {written[0].parent}: {', '.join(path.name for path in written)}.")


def make_report_summary(record: PushTaskRecord) -> ReportSummary:
    """The run for the report's head."""
    pushes = [seen.push for seen in record.log]
    steps = []
    for number, (seen, pose) in enumerate(zip(record.log, record.rest_poses[1:], strict=False), start=1):
        x, y = seen.push.start.tolist()
        left = float(calc_goal_error(record.obj, pose, record.goal)) * MM
        steps.append((str(number), f"({x:.3f}, {y:.3f}) m, {seen.push.length * MM:.0f} mm far", f"{left:.0f} mm"))
    return ReportSummary(
        verdict=record.message,
        facts=(
            ("pushes", str(record.pushes)),
            ("left to go", f"{record.error * MM:.1f} mm"),
            ("simulated", f"{record.duration:.0f} s"),
        ),
        figure=draw_push_run(
            record.obj,
            record.rest_poses,
            pushes,
            record.goal,
            record.surface,
            expected=record.expected_errors,
            tolerance=record.tolerance,
        ),
        caption="The object at rest after every push, the pushes as arrows, the goal dotted; and how far off it was.",
        heads=HEADS,
        steps=steps,
    )


TASK = DemoTask(FILES, PushScenario, run, write, judge, tell)
"""As the demo uses it."""
