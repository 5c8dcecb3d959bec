"""`gridpush predict`: predicts where pushes take an object."""

import csv
import io
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from gridpush_drake.cli.shell import options
from gridpush_drake.cli.shell.console import count_noun, print_json, print_line, print_table
from gridpush_drake.dynamics.motion import MotionStatus
from gridpush_drake.errors import PushLogError
from gridpush_drake.files import write_whole
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import (
    ErrorSummary,
    PoseError,
    Prediction,
    calc_final_errors,
    summarize_errors,
)
from gridpush_drake.identification.spread import Spread, predict_spread
from gridpush_drake.identification.statistics.problem import find_fastest
from gridpush_drake.pushes.misplaced import explain_no_contact
from gridpush_drake.units import DEG_PER_RAD, MM_PER_M

PREDICTION_COLUMNS = ("push", "x", "y", "theta")
"""Header of the file that is written: a push's name and the object's final pose, world frame, m,
rad."""


def predict(
    model: options.ObjectOrModel,
    pushes: options.PushesFile,
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            "-o",
            metavar="PREDICTED.csv",
            help="The file to write: a line push,x,y,theta for each push, with the object's "
            "predicted final pose in the world frame, m and rad.",
        ),
    ],
    regime: options.Regime = "auto",
    largest_piece: options.LargestPiece = False,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Predict where pushes take an object, and compare with where they really took it.

    The errors are printed for the pushes whose end is in the log. Without a learned model, the
    object's mass and friction are assumed to be spread evenly.

    Example: gridpush predict model.yaml pushes.csv --out predicted.csv
    """
    options.check_outputs(force, out, inputs=(model, pushes))
    target = options.load_target(model, largest_piece)
    full = options.load_log(pushes, target.obj, require_final=False)
    log = full.supported
    supposed = Model(target.obj, target.params, target.make_physics(regime))
    used = supposed.resolve(find_fastest(log))
    options.compile_kernels()
    predictions = used.predict(log)
    if all(prediction.status == MotionStatus.NO_CONTACT for prediction in predictions):
        raise PushLogError(explain_no_contact(target.obj, log))
    write_whole(out, _make_csv(predictions), force)

    errors = calc_final_errors(target.obj, predictions, log)
    spreads = predict_spread(target.model, log, used.physics) if target.model else []
    summaries = summarize_errors(target.obj, predictions, log)
    radius_of_gyration = target.obj.radius_of_gyration
    # A learned model says how far off it expects 90 % of its predictions to be, which can be
    # compared with the errors wherever the end of a push is known
    judged = [
        error.cell <= spread.cell_error
        for error, spread in zip(errors, spreads, strict=False)
        if error is not None
    ]
    found: dict[str, Any] = {
        "object": target.obj.name,
        "model": "learned" if target.model else "prior",
        "regime": used.physics.regime,
        "pushes": len(predictions),
        "untouched": [
            prediction.name
            for prediction in predictions
            if prediction.status == MotionStatus.NO_CONTACT
        ],
        "overhanging": [seen.name for seen in full.overhanging],
        "errors": [_describe_summary(error) for error in summaries],
        "within_interval": [sum(judged), len(judged)],
        "written": [str(out)],
        "rho_mm": radius_of_gyration * MM_PER_M,
        "errors_by_push": [
            _describe_error(prediction.name, error, radius_of_gyration)
            for prediction, error in zip(predictions, errors, strict=True)
        ],
        "spread_by_push": [_describe_spread(spread) for spread in spreads],
    }
    if json:
        print_json(found)
        return
    if target.model is None:
        print_line(
            f"{model} is an object, not a model: its mass and friction are assumed to be spread "
            "evenly."
        )
    _print_found(found, summaries)
    print_line(f"Wrote {out}.")


def _print_found(found: dict[str, Any], summaries: list[ErrorSummary]) -> None:
    """Prints which pushes are special, and how far the predictions are off."""
    if found["untouched"]:
        print_line(f"The pusher never touches the object in: {', '.join(found['untouched'])}")
    if found["overhanging"]:
        print_line(options.describe_overhanging(found["overhanging"]))
    if summaries:
        print_errors(f"Errors of {count_noun(summaries[0].pushes, 'final pose')}", summaries)
    within, total = found["within_interval"]
    if total:
        print_line(
            f"{within} of {total} cell errors are within the distance that the model states for 90 "
            "% of them."
        )


def _describe_error(
    name: str, error: PoseError | None, radius_of_gyration: float
) -> dict[str, Any]:
    """Returns a push's errors for machines; all are None if the push's end is not known."""
    if error is None:
        return {
            "push": name,
            "position_mm": None,
            "angle_deg": None,
            "cell_mm": None,
            "combined_mm": None,
        }
    return {
        "push": name,
        "position_mm": error.position * MM_PER_M,
        "angle_deg": error.angle * DEG_PER_RAD,
        "cell_mm": error.cell * MM_PER_M,
        "combined_mm": error.combined(radius_of_gyration) * MM_PER_M,
    }


def _describe_spread(spread: Spread) -> dict[str, Any]:
    """Returns for machines how far off a learned model expects a push's final pose to be."""
    return {
        "push": spread.name,
        "x_std_mm": spread.std[0] * MM_PER_M,
        "y_std_mm": spread.std[1] * MM_PER_M,
        "theta_std_deg": spread.std[2] * DEG_PER_RAD,
        "cell_90_mm": spread.cell_error * MM_PER_M,
    }


def _describe_summary(error: ErrorSummary) -> dict[str, Any]:
    """Returns a summary of errors for machines; its numbers are in its unit, "mm" or "deg"."""
    values = {key: getattr(error, key) * error.scale for key in ("mean", "median", "p90")}
    return {
        "name": error.name,
        "unit": "deg" if error.unit == "°" else error.unit,
        "pushes": error.pushes,
        **values,
    }


def print_errors(title: str, errors: list[ErrorSummary]) -> None:
    """Prints a table of errors: the mean, the median and the 90th percentile of each kind."""
    table = Table("error", "mean", "median", "90 %", title=title, title_justify="left")
    for error in errors:
        values = (error.mean, error.median, error.p90)
        table.add_row(error.name, *(f"{value * error.scale:.2f} {error.unit}" for value in values))
    print_table(table)


def _make_csv(predictions: list[Prediction]) -> str:
    """Returns the CSV file of predicted final poses, with all digits of the numbers."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(PREDICTION_COLUMNS)
    writer.writerows(
        [prediction.name, *map(repr, prediction.poses[-1].tolist())] for prediction in predictions
    )
    return buffer.getvalue()
