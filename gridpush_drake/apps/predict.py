"""`gridpush predict`: where pushes take an object."""

import csv
import io
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gridpush_drake.apps import options
from gridpush_drake.apps.console import print_json, print_line, print_table

if TYPE_CHECKING:
    from gridpush_drake.identification.error_summary import ErrorSummary
    from gridpush_drake.identification.prediction import Prediction

COLUMNS = ("push", "x", "y", "theta")
"""Final pose of each push, m and rad, world frame."""


def predict(
    model: options.ObjectOrModel,
    pushes: options.PushesFile,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="PREDICTED.csv", help="Final poses: push,x,y,theta.")],
    regime: options.Regime = "auto",
    largest_piece: options.LargestPiece = False,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Predict where pushes take an object, and compare with where they took it."""
    from gridpush_drake.apps.inputs import load_log, load_target
    from gridpush_drake.apps.kernels import compile_kernels
    from gridpush_drake.dynamics.motion import MotionStatus
    from gridpush_drake.files import check_writable, write_whole
    from gridpush_drake.identification.error_summary import summarise_errors
    from gridpush_drake.identification.identify import choose_regime
    from gridpush_drake.identification.prediction import predict as predict_log

    check_writable(out, force)
    target = load_target(model, largest_piece)
    log = load_log(pushes, target.obj, require_final=False)
    chosen = target.resolve_regime(regime, choose_regime(target.obj, log))
    compile_kernels()
    predictions = predict_log(target.obj, target.params, log, chosen)
    write_whole(out, _make_csv(predictions), force)

    found: dict[str, Any] = {
        "object": target.obj.name,
        "model": "learned" if target.model else "prior",
        "regime": chosen,
        "pushes": len(predictions),
        "untouched": [prediction.name for prediction in predictions if prediction.status == MotionStatus.NO_CONTACT],
        "errors": summarise_errors(target.obj, predictions, log),
        "written": [str(out)],
    }
    if json:
        print_json({**found, "errors": [vars(error) for error in found["errors"]]})
    else:
        _print_found(found, model)


def _print_found(found: dict[str, Any], name: str) -> None:
    if found["model"] == "prior":
        print_line(f"{name} is an object, not a model: predicted with its prior, mass and friction spread evenly.")
    if found["untouched"]:
        print_line(f"The pusher never touches the object in: {', '.join(found['untouched'])}")
    if found["errors"]:
        print_errors(f"Errors of {found['errors'][0].pushes} final poses", found["errors"])
    print_line(f"Wrote {found['written'][0]}.")


def print_errors(title: str, errors: "list[ErrorSummary]") -> None:
    """Prints a table of errors."""
    from rich.table import Table

    table = Table("error", "mean", "median", "90 %", title=title, title_justify="left")
    for error in errors:
        values = (error.mean, error.median, error.p90)
        table.add_row(error.name, *(f"{value * error.scale:.2f} {error.unit}" for value in values))
    print_table(table)


def _make_csv(predictions: "list[Prediction]") -> str:
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows([prediction.name, *map(repr, prediction.poses[-1].tolist())] for prediction in predictions)
    return buffer.getvalue()
