"""`gridpush demo`: a robot that pokes an object it knows nothing about, and comes to know it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gridpush_drake.apps import options
from gridpush_drake.apps.console import count_progress, print_json, print_notice

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

    from gridpush_drake.scene.scenario import PushScenario
    from gridpush_drake.station.experiment import ExperimentRecord

FRAMES_A_SECOND = 20.0
"""Of the recording."""

EXIT_INTERRUPTED = 130


def demo(
    object_file: Annotated[
        str | None,
        typer.Option("--object", metavar="NAME|FILE", help="A shipped object's name, or an object file."),
    ] = None,
    scenario_file: Annotated[
        Path | None,
        typer.Option("--scenario", metavar="FILE", help="What stands where, as YAML; see models/scenarios."),
    ] = None,
    pushes: Annotated[int | None, typer.Option(min=1, help="How many pushes to learn from.  [default: 8]")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of everything random.  [default: 0]")] = None,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="DIR", help="Folder for what the demo writes.")] = Path(
        "gridpush_demo"
    ),
    open_browser: Annotated[
        bool, typer.Option("--open", help="Watch it in the browser, and open the report at the end.")
    ] = False,
    realtime_rate: Annotated[
        float, typer.Option(min=0, metavar="R", help="Simulated seconds a second, at most; 0: as fast as it goes.")
    ] = 0.0,
    port: Annotated[
        int | None, typer.Option(metavar="N", help="For Meshcat to listen on.  [default: the first free one from 7000]")
    ] = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Let a simulated iiwa poke an object whose weights are hidden, learn them, and write a report and a recording."""
    from gridpush_drake.apps.demo_files import FILES, write_demo
    from gridpush_drake.apps.demo_verdict import judge, print_verdict
    from gridpush_drake.apps.inputs import make_folder
    from gridpush_drake.apps.kernels import compile_kernels
    from gridpush_drake.files import check_writable
    from gridpush_drake.scene.meshcat_server import StartMeshcatServer
    from gridpush_drake.scene.scenario_check import check_scenario

    scenario = _make_scenario(scenario_file, object_file, pushes, seed)
    check_scenario(scenario)
    make_folder(out)
    for name in FILES:
        check_writable(out / name, force)
    meshcat = StartMeshcatServer(port)
    compile_kernels()
    print_notice(f"Watch it at {meshcat.web_url()}")
    if open_browser:
        typer.launch(meshcat.web_url())
    record = _run(scenario, meshcat, realtime_rate)
    written = write_demo(out, scenario, record, meshcat, force)
    verdict = judge(record)
    if json:
        print_json({**verdict, "written": [str(path) for path in written]})
    else:
        print_verdict(verdict, written)
    if open_browser and (out / FILES[0]) in written:
        typer.launch(str((out / FILES[0]).resolve()))
    if record.status == "interrupted":
        raise typer.Exit(EXIT_INTERRUPTED)


def _make_scenario(
    scenario_file: Path | None, object_file: str | None, pushes: int | None, seed: int | None
) -> "PushScenario":
    """The scenario of a file, or the default one, with what the command line says instead."""
    from gridpush_drake.scene.scenario import PushScenario
    from gridpush_drake.scene.scenario_file import read_scenario

    scenario = read_scenario(scenario_file) if scenario_file else PushScenario()
    if object_file is not None:
        scenario.object = object_file
    if pushes is not None:
        scenario.pokes.count = pushes
    if seed is not None:
        scenario.seed = seed
    return scenario


def _run(scenario: "PushScenario", meshcat: "Meshcat", realtime_rate: float) -> "ExperimentRecord":
    from gridpush_drake.station.experiment import PushExperiment
    from gridpush_drake.systems.push_status import PushStatus

    experiment = PushExperiment(scenario, meshcat)
    experiment.AimCamera(meshcat)
    training, total = scenario.pokes.count, scenario.pokes.count + scenario.pokes.test_count
    with count_progress("the robot", total) as report:

        def show(status: PushStatus, logged: int) -> None:
            kind = "push" if status.executed < training else "held-out push"
            at = min(status.executed + 1, total)
            refused = f" (refused {status.refused}: {status.reason})" if status.reason else ""
            report(f"{kind} {at} of {total}, {status.phase}{refused}", status.executed)

        meshcat.StartRecording(FRAMES_A_SECOND)
        return experiment.run(progress=show, realtime_rate=realtime_rate)
