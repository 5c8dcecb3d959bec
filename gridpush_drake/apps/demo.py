"""`gridpush demo`: learn a shipped object from simulated pushes with a hidden truth."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gridpush_drake.apps import options
from gridpush_drake.apps.console import MM, print_json, print_line, search_progress

if TYPE_CHECKING:
    from gridpush_drake.grid.parameters import CellParameters
    from gridpush_drake.identification.result import Identification
    from gridpush_drake.pushes.log import PushLog

FILES = ("report.html", "model.yaml", "object.yaml", "pushes.csv", "held_out.csv", "truth.yaml")

HELD_OUT = 6
"""Pushes kept back to judge the model by."""


def demo(
    object_file: Annotated[
        str, typer.Option("--object", metavar="NAME|FILE", help="A shipped object's name, or an object file.")
    ] = "claw_hammer",
    pushes: Annotated[int, typer.Option(min=1, help="How many pushes to learn from.")] = 8,
    seed: options.Seed = 0,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="DIR", help="Folder for what the demo writes.")] = Path(
        "gridpush_demo"
    ),
    open_report: Annotated[bool, typer.Option("--open", help="Open the report in the browser.")] = False,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Push a simulated object with a hidden mass and friction, learn them, and write a report."""
    from gridpush_drake.apps.demo_experiment import hide_truth, make_pushes
    from gridpush_drake.apps.inputs import load_object, make_folder
    from gridpush_drake.apps.kernels import compile_kernels
    from gridpush_drake.files import check_writable
    from gridpush_drake.identification.identify import identify

    obj = load_object(object_file)
    make_folder(out)
    for name in FILES:
        check_writable(out / name, force)
    compile_kernels()
    truth = hide_truth(obj, seed)
    log = make_pushes(obj, truth, pushes + HELD_OUT, seed)
    training, held_out = log[:pushes], log[pushes:]
    with search_progress(f"identifying {obj.name}", None) as progress:
        result = identify(obj, training, seed=seed, progress=progress)
    _write(out, result, training, held_out, truth, force)
    verdict = _judge(result, held_out, truth)
    if json:
        print_json({**verdict, "written": [str(out / name) for name in FILES]})
    else:
        _print_verdict(verdict)
        print_line(f"\nThe report is {out / FILES[0]}; beside it are {', '.join(FILES[1:])}.")
    if open_report:
        typer.launch(str((out / FILES[0]).resolve()))


def _write(
    folder: Path,
    result: "Identification",
    training: "PushLog",
    held_out: "PushLog",
    truth: "CellParameters",
    force: bool,
) -> None:
    import yaml

    from gridpush_drake.apps.demo_experiment import describe_truth
    from gridpush_drake.files import write_whole
    from gridpush_drake.grid.object_file import write_object
    from gridpush_drake.identification.model_file import write_model
    from gridpush_drake.report.html import make_report

    report, model, object_file, pushes, kept_back, true = (folder / name for name in FILES)
    write_whole(report, make_report(result, training, held_out, truth), force)
    write_model(model, result, force)
    write_object(object_file, result.obj, force=force)
    training.write_csv(pushes, force)
    held_out.write_csv(kept_back, force)
    write_whole(true, yaml.safe_dump(describe_truth(result.obj, truth), sort_keys=False), force)


def _judge(result: "Identification", held_out: "PushLog", truth: "CellParameters") -> dict[str, Any]:
    """Errors before and after learning; lengths in m."""
    import numpy as np

    from gridpush_drake.grid.parameters import CellParameters
    from gridpush_drake.identification.error_summary import calc_mean_cell_error

    obj = result.obj
    uniform = CellParameters.uniform(obj)

    def compare(params: CellParameters) -> dict[str, float]:
        gap = params.relative_friction() @ obj.p_BC - truth.relative_friction() @ obj.p_BC
        return {
            "held_out_cell_error": calc_mean_cell_error(obj, params, held_out, result.regime),
            "centre_of_friction_error": float(np.linalg.norm(gap)),
            "centre_of_mass_error": float(np.linalg.norm(params.centre_of_mass(obj) - truth.centre_of_mass(obj))),
        }

    return {
        "object": obj.name,
        "pushes": len(result.push_names),
        "held_out": len(held_out),
        "status": result.status,
        "message": result.message,
        "before": compare(uniform),
        "after": compare(result.params),
    }


def _print_verdict(verdict: dict[str, Any]) -> None:
    before, after = verdict["before"], verdict["after"]
    print_line(
        f"The {verdict['object'].replace('_', ' ')} after {verdict['pushes']} simulated pushes: {verdict['message']}"
    )
    for what, key in (
        (f"error of {verdict['held_out']} pushes held out", "held_out_cell_error"),
        ("error of the centre of friction", "centre_of_friction_error"),
        ("error of the centre of mass", "centre_of_mass_error"),
    ):
        print_line(f"  {what}: {before[key] * MM:.1f} mm assuming an even object, {after[key] * MM:.1f} mm as learned")
    print_line("  (slow pushes do not show mass by itself: the centre of mass supposes equal friction of all cells)")
