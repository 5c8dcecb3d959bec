"""`gridpush demo`: a robot and an object it knows nothing about: poked, learned, slid to the edge, grasped, lifted."""

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from gridpush_drake.cli import options
from gridpush_drake.cli.console import count_progress, print_json, print_line, print_notice
from gridpush_drake.cli.interrupts import EXIT_INTERRUPTED
from gridpush_drake.display.live_page import LivePage
from gridpush_drake.errors import OutputError, StationError
from gridpush_drake.files import make_folder_beside, output_folder
from gridpush_drake.station.camera import check_renderer
from gridpush_drake.station.resolve import resolve
from gridpush_drake.station.robot import make_robot_directives
from gridpush_drake.station.scenario_file import read_scenario
from gridpush_drake.station.scene import use_object
from gridpush_drake.station.tasks import TASKS, TaskKind, TaskName, write_files

EXIT_NOT_DONE = 1
"""Where everything went as it should but the robot did not get there."""


def demo(
    task: Annotated[
        TaskName,
        typer.Option(
            help="identify: poke an object and learn it; push: push it to a goal, learning on the way; pregrasp: poke "
            "it, learn it, slide it to the table's edge and lift it there."
        ),
    ] = TaskName.pregrasp,
    object_file: Annotated[
        str | None,
        typer.Option(
            "--object", metavar="NAME|FILE", help="A shipped object's name, or an object file."
        ),
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|DIR",
            help="gantry, iiwa14 or panda, or the folder of a robot.yaml of yours; its scene replaces the "
            "scenario's.  [default: the scenario's, an iiwa14]",
        ),
    ] = None,
    scenario_file: Annotated[
        Path | None,
        typer.Option(
            "--scenario",
            metavar="NAME|FILE",
            help="What stands where: a shipped scenario's name, such as grasp, or a YAML file.",
        ),
    ] = None,
    pushes: Annotated[
        int | None,
        typer.Option(min=1, help="How many pushes to learn from (--task identify).  [default: 8]"),
    ] = None,
    camera: Annotated[
        Literal["ideal", "rgbd"] | None,
        typer.Option(
            help="ideal: the robot is told object and poses, with noise; rgbd: it has a color and depth camera, "
            "finds the object in a photograph and tracks it.  [default: that of --scenario; without one rgbd, or "
            "ideal where nothing can be rendered]"
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Seed of everything random.  [default: the scenario's]"),
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", help="Folder for what the demo writes.")
    ] = Path("gridpush_demo"),
    open_browser: Annotated[
        bool,
        typer.Option("--open", help="Watch it in the browser, and open the report at the end."),
    ] = False,
    realtime_rate: Annotated[
        float,
        typer.Option(
            min=0,
            metavar="R",
            help="Greatest number of simulated seconds in a second; 0: as fast as it goes.",
        ),
    ] = 0.0,
    port: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Port of Meshcat's page, where the run can be watched.  [default: the first free one from 7000]",
        ),
    ] = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Let a simulated robot poke an object to learn it, then push or lift it; write a report and a recording.

    Exit code 1 where the robot did not reach its goal.
    """
    if pushes is not None and task is not TaskName.identify:
        raise options.OptionError(
            f"--pushes: is for --task identify; {task} decides itself how many to make"
        )
    chosen = TASKS[task]
    scenario = read_scenario(scenario_file) if scenario_file else chosen.make_scenario()
    told = None if object_file is None else use_object(scenario, object_file)
    if pushes is not None:
        scenario.pokes.count = pushes
    if camera is not None:
        scenario.camera.use(camera)
    if seed is not None:
        scenario.seed = seed
    if robot is not None:
        scenario.directives = make_robot_directives(robot, grasping=task is TaskName.pregrasp)
    if camera is None and scenario_file is None:
        scenario.camera.use(_choose_camera())
    resolved = resolve(scenario, scenario_file, told=told)
    with output_folder(out):
        options.check_outputs(force, *(out / name for name in chosen.files))
        page = LivePage(port)
        options.compile_kernels()
        print_notice(f"Watch it at {page.url}")
        if open_browser:
            typer.launch(page.url)
        with count_progress("the robot", chosen.count_steps(scenario)) as report_step:
            record = chosen.run(resolved, page, realtime_rate, report_step)
        folder = _find_place(out, chosen, force)
        print_notice(f"Writing to {folder} ...")
        written = write_files(chosen, folder, scenario, record, page.meshcat, force)
    summary = chosen.summarize(record)
    if json:
        print_json({**summary, "written": [str(path) for path in written]})
    else:
        print_summary(chosen, summary, written)
    report = folder / chosen.files[0]
    if open_browser and report in written:
        typer.launch(str(report.resolve()))
    if summary["status"] == "interrupted":
        raise typer.Exit(EXIT_INTERRUPTED)
    if not summary.get("done", True):
        raise typer.Exit(EXIT_NOT_DONE)


def _find_place(out: Path, task: TaskKind, force: bool) -> Path:
    """The folder for what a run came to: `out`, or a new one beside it where that was taken meanwhile."""
    try:
        options.check_outputs(force, *(out / name for name in task.files))
    except OutputError as error:
        beside = make_folder_beside(out)
        print_notice(f"{error}. What was done is kept in {beside} instead.")
        return beside
    return out


def print_summary(task: TaskKind, summary: dict[str, Any], written: list[Path]) -> None:
    """Prints what came of a run, and what was written."""
    for line in task.describe(summary):
        print_line(line)
    print_line(f"\nIn {written[0].parent}: {', '.join(path.name for path in written)}.")


def _choose_camera() -> Literal["ideal", "rgbd"]:
    """The camera that sees for itself, where its pictures can be rendered."""
    try:
        check_renderer()
    except StationError as error:
        print_notice(f"The robot is told object and poses, as with --camera ideal: {error}.")
        return "ideal"
    return "rgbd"
