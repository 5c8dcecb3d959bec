"""`gridpush robot`: carries out a task with a real arm, or with its twin, over LCM or ROS 2.

An arm must never be left moving by itself. Therefore this command handles signals and a lost
terminal in its own way: they stop the arm smoothly, and the files are still written.
"""

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from gridpush_drake.cli.run.demo import EXIT_NOT_DONE, Task, print_summary
from gridpush_drake.cli.run.open_link import ByRos2, LcmUrl, check_address, check_robot, open_link
from gridpush_drake.cli.run.twin import (
    DEFAULT_SCENARIO,
    ObjectFile,
    RealtimeRate,
    Scenario,
    read_robot_scenario,
)
from gridpush_drake.cli.run.unknown_inertia import UnknownInertia, hide_inertia
from gridpush_drake.cli.shell import options
from gridpush_drake.cli.shell.console import (
    PLACE_FORMAT,
    count_progress,
    print_json,
    print_line,
    print_notice,
)
from gridpush_drake.cli.shell.interrupts import (
    EXIT_INTERRUPTED,
    SIGNAL_EXIT_BASE,
    is_hangup,
    set_handlers,
)
from gridpush_drake.cli.shell.output import losable_outputs
from gridpush_drake.errors import GridPushError, StationError
from gridpush_drake.files import make_folder, write_whole
from gridpush_drake.station.hardware.hardware_link import HardwareLink
from gridpush_drake.station.hardware.hardware_station import MakeHardwareStation
from gridpush_drake.station.hardware.ros2_estimate import Ros2Estimate
from gridpush_drake.station.links.lcm.lcm_address import DEFAULT_URL
from gridpush_drake.station.links.link import Link, LinkRole
from gridpush_drake.station.links.ros2.ros2_link import Ros2Link
from gridpush_drake.station.recording.rerun_view import RerunView
from gridpush_drake.station.recording.run_recorder import RunRecorder
from gridpush_drake.station.scene.resolve import ResolvedScenario, resolve
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.schema.task_table import DEFAULT_TASK
from gridpush_drake.station.tasks.registry import TASK_KINDS
from gridpush_drake.station.tasks.task import StationTask
from gridpush_drake.station.tasks.task_kind import TaskKind, write_files
from gridpush_drake.systems.base.messages import PushCommand
from gridpush_drake.units import MM_PER_M

LOG_FILE = "robot.log"
"""Name of the file that says what happened when, and whether the control loop was in time. It is
written besides the files of `gridpush demo`."""

MAX_PLAN_WAIT = 20.0
"""Longest time that a command without --go waits for the first push to be planned, s."""

NO_FORCE_SENSE = (
    "Nothing says how the world presses on the arm (no wrench comes): the guard notices an "
    "obstacle only by joints that do not follow."
)
"""What is printed if the robot's driver is known to have no sense of force."""


def robot(
    task: Task = DEFAULT_TASK,
    scenario_file: Scenario = None,
    object_file: ObjectFile = None,
    lcm: LcmUrl = DEFAULT_URL,
    ros2: ByRos2 = False,
    unknown_inertia: UnknownInertia = False,
    go: Annotated[
        bool,
        typer.Option(
            "--go",
            help="Really move the arm. Without it the command prints what it sees and which push "
            "it would make first, and ends.",
        ),
    ] = False,
    seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Seed of everything random, such as where the robot pokes.",
            show_default="the scenario's",
        ),
    ] = None,
    realtime_rate: RealtimeRate = 1.0,
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            help="Folder for the log, the report, the model and the pushes; it is made if it is "
            "missing.",
        ),
    ] = Path("gridpush_robot"),
    record_file: options.Record = None,
    rerun: options.Rerun = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Carry out a task of `gridpush demo` with a real arm. Nothing moves without --go.

    The arm's driver is spoken to over LCM or ROS 2; docs/hardware.md says how, and what to check
    before the first run. Ctrl-C, a lost terminal, and anything that seems wrong stop the arm
    smoothly and hold it where it is.

    The exit code is 1 if the task was not done, and 128 plus the signal's number after a signal,
    which is 130 after Ctrl-C.

    Example: gridpush robot --task identify --scenario cell.yaml --go
    """
    chosen = TASK_KINDS[task]
    scenario, obj = read_robot_scenario(scenario_file, object_file, seed)
    if unknown_inertia:
        hide_inertia(scenario, task)
    # In simulation the robot waits until an answer is calculated; a real arm does not stand still
    scenario.simulation.answer_delay = None
    resolved = resolve(scenario, scenario_file or DEFAULT_SCENARIO, known_object=obj)

    # Whatever can be refused is refused now, before the robot is spoken to
    chosen.check(resolved, list_link_faults(resolved, ros2, is_known=obj is not None))
    check_address(ros2, lcm)
    if go:
        make_folder(out)
        outputs = [out / name for name in (*chosen.list_files(resolved), LOG_FILE)]
        options.check_outputs(force, *outputs, record_file)
    options.compile_kernels()
    station_task = chosen.make_task(resolved, make_station=MakeHardwareStation)
    with closing(open_link(LinkRole.CONTROL, resolved, ros2, lcm)) as network:
        link = HardwareLink(
            network,
            resolved.robot,
            others=scenario.names.name_others(len(scenario.others)),
            realtime_rate=realtime_rate,
            clock_jump=scenario.safety.clock_jump,
        )
        link.wait()
        if isinstance(network, Ros2Link) and not network.load_known:
            print_notice(NO_FORCE_SENSE)
        if not go:
            _look(station_task, link, json)
            return
        with _stopping(link) as asked:
            recorder = None if record_file is None else RunRecorder()
            view = None if rerun is None else RerunView(rerun, force)
            watchers = [each.note for each in (recorder, view) if each is not None]
            record = _run(station_task, link, network, watchers)
            if view is not None:
                view.finish()
            summary = _report(chosen, scenario, record, link, out, force, json)
            if recorder is not None and record_file is not None:
                recorder.write(record_file, record, force)
                print_notice(f"The run is recorded in {record_file}.")
    if summary["status"] == "interrupted":
        raise typer.Exit(SIGNAL_EXIT_BASE + asked.number if asked.number else EXIT_INTERRUPTED)
    if not summary.get("done", summary["status"] == "finished"):
        raise typer.Exit(EXIT_NOT_DONE)


def list_link_faults(resolved: ResolvedScenario, ros2: bool, is_known: bool) -> list[str]:
    """Lists why the robot of a scenario cannot be spoken to, or told of its object.

    Args:
        resolved: the scenario.
        ros2: whether the robot is spoken to over ROS 2.
        is_known: whether `--object` says what the object is.
    """
    faults = []
    if resolved.scenario.camera.kind == "rgbd" and not is_known and not resolved.others:
        faults.append(
            "--object: missing; if the scenario has camera.kind rgbd, expected the object file "
            "that gridpush tracker wrote"
        )
    try:
        check_robot(resolved.robot, ros2)
    except StationError as error:
        faults.append(str(error))
    return faults


@dataclass
class StopRequest:
    """Whether a signal asked the robot to stop.

    Attributes:
        number: number of the first signal; 0 if none came.
    """

    number: int = 0


@contextmanager
def _stopping(link: HardwareLink) -> Iterator[StopRequest]:
    """Lets a signal or a lost terminal stop the arm instead of ending the process.

    The process goes on until the arm is at rest and the files are written. If the same signal comes
    a second time, it ends the process at once, and the robot's driver holds the arm. This does not
    hold for SIGHUP, as a lost terminal sends several.

    Yields:
        Which signal asked to stop, if one did.
    """
    asked = StopRequest()

    def stop(number: int, _: Any) -> None:
        if not is_hangup(number):
            signal.signal(number, before[number])
        if not asked.number:
            asked.number = number
            link.note(f"asked to stop by {signal.Signals(number).name}")
        link.request_stop()

    def stop_unheard(error: OSError) -> None:
        link.note(f"asked to stop: nobody can read what is printed any more ({error.strerror})")
        link.request_stop()

    before = set_handlers(stop)
    try:
        with losable_outputs(stop_unheard):
            yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _run(
    task: StationTask[Any],
    link: HardwareLink,
    network: Link,
    watchers: Sequence[Callable[[Any], None]],
) -> Any:
    """Lets the arm move until the task ends or is stopped; returns the task's record."""
    estimate = None
    if isinstance(network, Ros2Link):
        estimate = Ros2Estimate(network, task, link)
    with count_progress("the robot", 1) as report:
        link.armed = True
        context = task.simulator.get_context

        def show(status: Any, logged: int) -> None:
            if estimate is not None:
                estimate.publish()
            for watch in watchers:
                watch(task)
            report(f"{status.phase}, {logged} pushes logged", f"{context().get_time():.0f} s")

        return task.run(progress=show, drive=link)


def _report(
    task: TaskKind,
    scenario: PushScenario,
    record: Any,
    link: HardwareLink,
    out: Path,
    force: bool,
    json: bool,
) -> dict[str, Any]:
    """Writes the files of a run, prints how it ended, and returns its summary.

    After a failure it writes as many files as can be made.
    """
    # the log first: it does not depend on how far the run came
    write_whole(out / LOG_FILE, _format_log(link), force)
    written: list[Path] = []
    unwritten = ""
    try:
        written = write_files(task, out, scenario, record, None, force)
        summary = task.summarize(record)
    except Exception as error:
        if isinstance(error, GridPushError) or not link.report.traces:
            raise
        # The controller has failed, and what it failed over may be missing in the record, too
        unwritten = (
            f"Some files could not be made after the failure: {type(error).__name__}: {error}."
        )
        summary = {"status": str(record.status), "message": record.message, "done": False}
    summary["loop"] = _describe_loop(link)
    files = [*written, out / LOG_FILE]
    if json:
        print_json({**summary, "written": [str(path) for path in files]})
    elif not unwritten:
        print_summary(task, summary, files)
        print_line(f"Control loop: {link.report.describe()}.")
    if summary["status"] in ("stopped", "interrupted"):
        print_notice(
            f"gridpush: {record.message} Before another run put right what stopped this one; give "
            "it another --out, as --force only replaces the files of this one."
        )
    if unwritten:
        print_notice(f"gridpush: {unwritten} {out / LOG_FILE} says what happened.")
    return summary


def _look(task: StationTask[Any], link: HardwareLink, json: bool) -> None:
    """Prints what the robot sees, and which push it would make first. Nothing moves."""
    push = task.preview(link, MAX_PLAN_WAIT)
    pose = task.read("object.pose")
    others = []
    for other in task.station.others:
        seen_there = task.read(f"{other.name}.pose")
        others.append(seen_there.tolist())
    tip = task.read("pusher.state")[:3]
    seen: dict[str, Any] = {
        "status_age": link.status_age,
        "joints": task.read(f"{task.station.robot.arm_model}.position_measured").tolist(),
        "tip": tip.tolist(),
        "object_pose": pose.tolist(),
        "other_poses": others,
        "first_push": None if push is None else [push.x, push.y, push.direction, push.distance],
    }
    if json:
        print_json(seen)
        return
    print_line(f"The robot's last status is {1e3 * seen['status_age']:.0f} ms old.")
    print_line(f"The joints are at [{', '.join(f'{q:.3f}' for q in seen['joints'])}] rad.")
    print_line("The finger's tip is at ({:.3f}, {:.3f}, {:.3f}) m.".format(*tip))
    where = PLACE_FORMAT.format(*pose)
    print_line(f"The object lies at {where}.")
    called = task.station.scenario.names.name_others(len(others))
    for name, other in zip(called, others, strict=True):
        where = PLACE_FORMAT.format(*other)
        print_line(f"{name} lies at {where}.")
    print_line(_describe_push(push))
    print_line("Nothing has moved. With --go the arm will move.")


def _describe_push(push: PushCommand | None) -> str:
    """Returns a sentence about the push that would be made first."""
    if push is None:
        return f"No push was found within {MAX_PLAN_WAIT:g} s."
    return (
        f"The first push: from ({push.x:.3f}, {push.y:.3f}) m towards {push.direction:.2f} rad, "
        f"{push.distance * MM_PER_M:.0f} mm far at {push.speed * MM_PER_M:.0f} mm/s."
    )


def _describe_loop(link: HardwareLink) -> dict[str, Any]:
    """Returns for machines whether the control loop was in time, and what it left out."""
    report = link.report
    return {
        "commands": report.steps,
        "worst_period": report.worst_period,
        "late_share": report.late_fraction,
        "pauses": report.pauses,
        "silences": report.silences,
        "force": report.force,
        "left_out": dict(report.left_out),
        "causes": report.causes,
    }


def _format_log(link: HardwareLink) -> str:
    """Returns the text of `LOG_FILE`: a line for each event, the loop's summary, and tracebacks."""
    lines = [f"{time:10.3f} s  {text}" for time, text in link.report.events]
    return "\n".join([*lines, link.report.describe(), *link.report.traces, ""])
