"""`gridpush robot`: a task with a real arm, or its twin, over LCM.

What is slow to import is imported when the command runs, so that `gridpush` starts fast.
"""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gridpush_drake.cli import options
from gridpush_drake.cli.console import MM, count_progress, print_json, print_line, print_notice
from gridpush_drake.cli.demo import EXIT_INTERRUPTED, EXIT_NOT_DONE, TaskName
from gridpush_drake.cli.twin import (
    DEFAULT_URL,
    LcmUrl,
    ObjectFile,
    RealtimeRate,
    Scenario,
    read_robot_scenario,
)
from gridpush_drake.errors import ScenarioError

if TYPE_CHECKING:
    from gridpush_drake.station.lcm.hardware_link import HardwareLink
    from gridpush_drake.station.task import StationTask
    from gridpush_drake.systems.messages import PushCommand

LOG = "robot.log"
"""That it leaves beside what a demo does."""

LOOKING = 20.0
"""For the first push to be planned, where nothing is to move, s."""


def robot(
    task: Annotated[
        TaskName, typer.Option(help="What the robot is to do; see gridpush demo.")
    ] = TaskName.pregrasp,
    scenario_file: Scenario = None,
    object_file: ObjectFile = None,
    lcm: LcmUrl = DEFAULT_URL,
    go: Annotated[
        bool,
        typer.Option(
            "--go", help="Move. Without it the command says what it sees and would do, and ends."
        ),
    ] = False,
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Seed of the pokes that are drawn.  [default: the scenario's]"),
    ] = None,
    realtime_rate: RealtimeRate = 1.0,
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", metavar="DIR", help="Folder for log, report, model and pushes."
        ),
    ] = Path("gridpush_robot"),
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Carry out a task of `gridpush demo` with a real arm over LCM; nothing moves before --go.

    Ctrl-C stops the arm smoothly and holds it there. So does anything that seems wrong.

    Exit code 1 where the task was not done, 130 after Ctrl-C.
    """
    from gridpush_drake.cli.demo_tasks import TASKS, print_summary, write_files
    from gridpush_drake.files import make_folder, write_whole
    from gridpush_drake.station.lcm.hardware_link import HardwareLink, open_lcm
    from gridpush_drake.station.lcm.hardware_station import MakeHardwareStation
    from gridpush_drake.station.robot import find_robot
    from gridpush_drake.station.scene import check_scenario

    chosen, scenario = TASKS[task], read_robot_scenario(scenario_file, object_file, seed)
    scenario.simulation.answer_delay = None  # a real arm waits for nobody
    check_scenario(scenario, scenario_file)
    if scenario.camera.kind == "rgbd" and object_file is None:
        raise ScenarioError(
            "--object: missing; with camera.kind rgbd, expected the file that gridpush tracker wrote"
        )
    if go:
        make_folder(out)
        options.check_outputs(force, *(out / name for name in (*chosen.files, LOG)))
    link = HardwareLink(open_lcm(lcm), find_robot(scenario.directives), realtime_rate=realtime_rate)
    link.wait()
    options.compile_kernels()
    station_task = chosen.station(scenario, make_station=partial(MakeHardwareStation, lcm=link.bus))
    if not go:
        _look(station_task, link, json)
        return
    with _stopping(link):
        record = _run(station_task, link)
    written = write_files(chosen, out, scenario, record, None, force)
    write_whole(out / LOG, _format_log(link), force)
    summary = {**chosen.summarize(record), "loop": _describe_loop(link)}
    if json:
        print_json({**summary, "written": [str(path) for path in (*written, out / LOG)]})
    else:
        print_summary(chosen, summary, [*written, out / LOG])
        print_line(f"The loop: {link.report.describe()}.")
    if summary["status"] in ("stopped", "interrupted"):
        print_notice(
            f"gridpush: {record.message} To go on, run the command again with --force, or another --out."
        )
    if summary["status"] == "interrupted":
        raise typer.Exit(EXIT_INTERRUPTED)
    if not summary.get("done", summary["status"] == "finished"):
        raise typer.Exit(EXIT_NOT_DONE)


def _run(task: "StationTask[Any]", link: "HardwareLink") -> Any:
    with count_progress("the robot", 1) as report:
        link.armed = True
        context = task.simulator.get_context

        def show(status: Any, logged: int) -> None:
            report(f"{status.phase}, {logged} pushes logged", f"{context().get_time():.0f} s")

        return task.run(progress=show, drive=link)


@contextmanager
def _stopping(link: "HardwareLink") -> Iterator[None]:
    """Lets the first signal stop the arm; a second one ends the process, and the driver holds the arm."""
    before: dict[signal.Signals, Any] = {}

    def stop(number: int, _: Any) -> None:
        link.request_stop()
        signal.signal(number, before[signal.Signals(number)])

    for number in (signal.SIGINT, signal.SIGTERM):
        before[number] = signal.signal(number, stop)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _look(task: "StationTask[Any]", link: "HardwareLink", json: bool) -> None:
    """Says what is seen, and the first push that would be made; nothing moves."""
    push = task.preview(link, LOOKING)
    pose, tip = task.read("object.pose"), task.read("pusher.state")[:3]
    seen: dict[str, Any] = {
        "status_age": link.status_age,
        "joints": task.read(f"{task.station.robot.arm_model}.position_measured").tolist(),
        "tip": tip.tolist(),
        "object_pose": pose.tolist(),
        "first_push": None if push is None else [push.x, push.y, push.direction, push.distance],
    }
    if json:
        print_json(seen)
        return
    print_line(f"The robot's last status is {1e3 * seen['status_age']:.0f} ms old.")
    print_line(f"The joints are at [{', '.join(f'{q:.3f}' for q in seen['joints'])}] rad.")
    print_line("The finger's tip is at ({:.3f}, {:.3f}, {:.3f}) m.".format(*tip))
    print_line("The object lies at ({:.3f}, {:.3f}) m, turned by {:.2f} rad.".format(*pose))
    print_line(_describe_push(push))
    print_line("Nothing has moved. With --go it will.")


def _describe_push(push: "PushCommand | None") -> str:
    if push is None:
        return f"No push was found within {LOOKING:g} s."
    return (
        f"The first push: from ({push.x:.3f}, {push.y:.3f}) m towards {push.direction:.2f} rad, "
        f"{push.distance * MM:.0f} mm far at {push.speed * MM:.0f} mm/s."
    )


def _describe_loop(link: "HardwareLink") -> dict[str, Any]:
    report = link.report
    return {
        "commands": report.steps,
        "worst_period": report.worst_period,
        "late_share": report.late_share,
        "pauses": report.pauses,
        "silences": report.silences,
        "force": report.force,
        "left_out": report.left_out,
    }


def _format_log(link: "HardwareLink") -> str:
    lines = [f"{time:10.3f} s  {text}" for time, text in link.report.events]
    return "\n".join([*lines, link.report.describe(), ""])
