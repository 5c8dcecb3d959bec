"""`gridpush demo`: a simulated robot learns an object by poking it, and pushes or lifts it."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from gridpush_drake.cli.run.unknown_inertia import UnknownInertia, hide_inertia
from gridpush_drake.cli.shell import options
from gridpush_drake.cli.shell.console import count_progress, print_json, print_line, print_notice
from gridpush_drake.cli.shell.interrupts import EXIT_INTERRUPTED
from gridpush_drake.cli.shell.kernels import compiling_meanwhile
from gridpush_drake.display.live_page import LivePage
from gridpush_drake.errors import OutputError, StationError
from gridpush_drake.files import make_folder_beside, output_folder
from gridpush_drake.station.recording.rerun_view import RerunView
from gridpush_drake.station.recording.run_recorder import RunRecorder
from gridpush_drake.station.robot.robot import make_robot_directives
from gridpush_drake.station.scene.camera import check_renderer
from gridpush_drake.station.scene.contents import use_object
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.schema.scenario_file import read_scenario
from gridpush_drake.station.schema.task_table import DEFAULT_TASK, TASKS
from gridpush_drake.station.tasks.registry import TASK_KINDS, explain_tasks, name_tasks
from gridpush_drake.station.tasks.task_kind import TaskKind, write_files

EXIT_NOT_DONE = 1
"""Exit code if the command worked as it should, but the robot did not reach its goal."""

COUNTED_TASKS = name_tasks(lambda kind: kind.counts_pokes)
"""Tasks that `--pushes` goes with, in words."""

HIDING_TASKS = name_tasks(lambda kind: kind.hides)
"""Tasks in which the arm hides the object from the camera, in words."""


def check_task(name: str) -> str:
    """Returns the name of a task.

    Raises:
        BadParameter: there is no such task.
    """
    if name not in TASKS:
        raise typer.BadParameter(f"{name!r} is not one of {', '.join(map(repr, TASKS))}.")
    return name


def make_task_option(text: str) -> Any:
    """Makes the option `--task`, with the text of its help."""
    return typer.Option(
        metavar="TASK", callback=check_task, autocompletion=lambda: list(TASKS), help=text
    )


Task = Annotated[
    str,
    make_task_option(
        f"What the robot should do: {', '.join(TASKS)}; `gridpush demo --help` explains each."
    ),
]
"""The task, where `gridpush demo` explains what each is."""


def demo(
    task: Annotated[
        str, make_task_option(f"What the robot should do. {explain_tasks()}")
    ] = DEFAULT_TASK,
    object_file: Annotated[
        str | None,
        typer.Option(
            "--object",
            metavar="NAME|FILE",
            help="The object on the table: a shipped object's name, or an object file.",
            show_default="the scenario's",
        ),
    ] = None,
    robot: options.RobotScene = None,
    pusher: options.PusherOption = None,
    scenario_file: Annotated[
        Path | None,
        typer.Option(
            "--scenario",
            metavar="NAME|FILE",
            help="What stands where: a shipped scenario's name, such as grasp, or a YAML file.",
            show_default="one that suits the task",
        ),
    ] = None,
    pushes: Annotated[
        int | None,
        typer.Option(
            min=1,
            help=f"How many pokes to learn from; only with --task {COUNTED_TASKS}.",
            show_default="the scenario's, 8",
        ),
    ] = None,
    unknown_inertia: UnknownInertia = False,
    camera: Annotated[
        Literal["ideal", "rgbd"] | None,
        typer.Option(
            help="What the robot sees. rgbd: it has a simulated color and depth camera, finds the "
            "object's outline in a picture and follows it; ideal: it is told the exact outline, "
            "and the object's poses with a little noise, which takes less than half the time. "
            "In tasks with several objects the robot is told all outlines, and with rgbd it "
            "follows all of them in its pictures.",
            show_default="that of --scenario; without one rgbd, or ideal if nothing can be "
            f"rendered, for several objects, or for --task {HIDING_TASKS}, where the arm hides the "
            "object",
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Seed of everything random.", show_default="the scenario's"),
    ] = None,
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            help="Folder for the files that the demo writes; it is made if it is missing.",
        ),
    ] = Path("gridpush_demo"),
    open_browser: Annotated[
        bool,
        typer.Option(
            "--open",
            help="Open the run in the browser at the beginning, and the report at the end.",
        ),
    ] = False,
    realtime_rate: Annotated[
        float,
        typer.Option(
            min=0,
            metavar="R",
            help="How many seconds are simulated in one second at most; 1 is real time, and 0 "
            "means as fast as possible.",
        ),
    ] = 0.0,
    port: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Port of the page where the run can be watched in a browser.",
            show_default="the first free one from 7000",
        ),
    ] = None,
    record_file: options.Record = None,
    rerun: options.Rerun = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Let a simulated robot learn an object by poking it, and then push or lift it.

    The command writes a report, a recording of the run, the learned model, and the pushes that it
    was learned from. The exit code is 1 if the robot did not reach its goal.

    Example: gridpush demo --task push --object toolbox --out pushed
    """
    chosen = TASK_KINDS[task]
    if pushes is not None and not chosen.counts_pokes:
        raise options.OptionError(
            f"--pushes: goes with --task {COUNTED_TASKS} only; in --task {task} the robot itself "
            "decides how many pushes to make"
        )
    # The scenario, with what the command line says instead
    scenario = read_scenario(scenario_file) if scenario_file else chosen.make_scenario()
    known_object = None if object_file is None else use_object(scenario, object_file, "--object")
    if pushes is not None:
        scenario.pokes.count = pushes
    if camera is not None:
        scenario.camera.use(camera)
    if seed is not None:
        scenario.seed = seed
    if unknown_inertia:
        hide_inertia(scenario, task)
    if pusher is not None:
        if robot is None and pusher != scenario.pusher:
            raise options.OptionError(f"--pusher {pusher}: expected --robot NAME beside it")
        scenario.pusher = pusher
    if robot is not None:
        scenario.directives = make_robot_directives(
            robot, grasping=chosen.grasps, pusher=scenario.pusher
        )
    if camera is None and scenario_file is None:
        scenario.camera.use("ideal" if chosen.needs_poses else _choose_camera())
    resolved = resolve(scenario, scenario_file or chosen.scenario, known_object=known_object)
    chosen.check(resolved)

    # Everything that can be refused is refused now, before minutes are spent
    files = chosen.list_files(resolved)
    with output_folder(out):
        options.check_outputs(force, *(out / name for name in files), record_file)
        recorder = None if record_file is None else RunRecorder()
        view = None if rerun is None else RerunView(rerun, force)
        watchers = [each.note for each in (recorder, view) if each is not None]
        page = LivePage(port)

        def show_page() -> None:
            print_notice(f"Watch it at {page.url}")
            if open_browser:
                typer.launch(page.url)

        with (
            compiling_meanwhile(),
            count_progress("the robot", chosen.count_steps(scenario)) as report_step,
        ):
            # Making the station may still refuse the scenario, so that the page is shown only when
            # the robot has begun.
            report = call_first(show_page, report_step)
            record = chosen.run(resolved, page, realtime_rate, report, watchers)
        if view is not None:
            view.finish()
        folder = _find_place(out, files, force)
        print_notice(f"Writing to {folder} ...")
        written = write_files(chosen, folder, scenario, record, page.meshcat, force)
        if recorder is not None and record_file is not None:
            recorder.write(record_file, record, force)
    summary = chosen.summarize(record)
    if json:
        outputs = written if record_file is None else [*written, record_file]
        print_json({**summary, "written": [str(path) for path in outputs]})
    else:
        print_summary(chosen, summary, written)
        if record_file is not None:
            print_line(f"The run is recorded in {record_file}.")
    report_file = folder / files[0]
    if open_browser and report_file in written:
        typer.launch(str(report_file.resolve()))
    if summary["status"] == "interrupted":
        raise typer.Exit(EXIT_INTERRUPTED)
    if not summary.get("done", True):
        raise typer.Exit(EXIT_NOT_DONE)


def call_first(begin: Callable[[], None], report: Callable[..., None]) -> Callable[..., None]:
    """Makes a report of some work that does something else before its first call.

    Args:
        begin: is called once, before `report` is called for the first time.
        report: the report, see `count_progress`.
    """
    begun = False

    def call(*args: Any, **named: Any) -> None:
        nonlocal begun
        if not begun:
            begun = True
            begin()
        report(*args, **named)

    return call


def _find_place(out: Path, files: Sequence[str], force: bool) -> Path:
    """Returns the folder to write to: `out`, or a new one if `out` was taken during the run."""
    try:
        options.check_outputs(force, *(out / name for name in files))
    except OutputError as error:
        beside = make_folder_beside(out)
        # the run took minutes, so that its files are worth more than a refusal
        print_notice(f"{error}. The files of this run are kept in {beside} instead.")
        return beside
    return out


def print_summary(task: TaskKind, summary: dict[str, Any], written: list[Path]) -> None:
    """Prints how a run ended, and which files were written.

    Args:
        task: the task that was run.
        summary: what `task.summarize` returned.
        written: the files that were written, all to one folder.
    """
    for line in task.describe(summary):
        print_line(line)
    names = ", ".join(path.name for path in written)
    print_line(f"\nWritten to {written[0].parent}: {names}.")


def _choose_camera() -> Literal["ideal", "rgbd"]:
    """Returns "rgbd" if pictures can be rendered on this computer, else "ideal", and says why."""
    try:
        check_renderer()
    except StationError as error:
        print_notice(
            f"The robot is told the object's outline and poses, as with --camera ideal: {error}."
        )
        return "ideal"
    return "rgbd"
