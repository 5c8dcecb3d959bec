"""The push log that `gridpush view` shows: its object, its pushes, and their predictions."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gridpush_drake.cli.shell import options
from gridpush_drake.cli.shell.console import count_noun
from gridpush_drake.cli.view.view_scene import describe_colors
from gridpush_drake.display.cell_colors import Shown
from gridpush_drake.errors import GridPushError
from gridpush_drake.files import exists, is_file
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.model_file import MODEL_FILE, looks_like_model
from gridpush_drake.identification.prediction import (
    Prediction,
    calc_cell_errors,
    predict,
    summarize_errors,
)
from gridpush_drake.objects.object_file import OBJECT_FILE, speak_name
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.units import MM_PER_M


class ViewError(GridPushError):
    """A file cannot be shown in the way that was asked for."""


@dataclass(frozen=True)
class OfPushes:
    """Options that go with a push log.

    Attributes:
        object_file: the object that was pushed; None for the one beside the log.
        model_file: the model by which pushes are predicted; None for the one beside the log.
        names: names of the pushes to replay; None for all.
    """

    object_file: str | None
    model_file: Path | None
    names: list[str] | None


def find_target(
    log: Path, object_file: str | None, model_file: Path | None, largest_piece: bool
) -> options.Target:
    """Reads the model or the object of a push log.

    It is the one that the user names, else the one beside the log under a name that the demo uses.
    """
    if model_file is not None and not looks_like_model(model_file):
        raise ViewError(
            f"--model: {model_file} is not a model; expected a file that `gridpush identify` wrote"
        )
    beside = (log.parent / MODEL_FILE, log.parent / OBJECT_FILE)
    chosen = model_file or object_file or next((path for path in beside if is_file(path)), None)
    if not exists(log):
        raise ViewError(f"{log}: there is no such file")
    if chosen is None:
        raise ViewError(
            f"{log}: its object is unknown; expected --object, --model, or {MODEL_FILE} or "
            f"{OBJECT_FILE} beside it"
        )
    return options.load_target(str(chosen), largest_piece)


def find_targets(
    log: Path, named: Sequence[str], largest_piece: bool
) -> tuple[list[options.Target], PushLog]:
    """Reads a push log of several objects, and their models or objects in the order of the log's.

    Args:
        log: the log.
        named: the objects, as NAME=FILE or FILE, with the names that they have in the log.
        largest_piece: as of `options.LargestPiece`.
    """
    targets = {}
    for text in named:
        name, file = options.split_name(text)
        target = options.load_target(file, largest_piece)
        targets[name or target.obj.name] = target
    read = PushLog.read_csv(log, require_final=False)
    options.check_names(log, read, targets)
    ordered = [targets[name] for name in read.names]
    return ordered, options.give_radius(read, [target.obj for target in ordered])


def describe_pushes(
    targets: Sequence[options.Target],
    picked: PushLog,
    predictions: list[Prediction] | None,
    shows: Shown,
) -> tuple[dict[str, Any], list[str]]:
    """Says which pushes are shown, and how well they are predicted; for machines and in lines."""
    if len(targets) > 1:
        return _describe_several(targets, picked, predictions)
    (target,) = targets
    # The model assumes a table below all of the object, so pushes over its edge are not judged
    overhanging = [seen.name for seen in picked.overhanging]
    judged = [prediction for prediction in predictions or [] if prediction.name not in overhanging]
    errors = summarize_errors(target.obj, judged, picked.supported) if judged else []
    lines = [f"{speak_name(target.obj.name)}: {count_noun(len(picked), 'push')}"]
    if predictions:
        lines.append("Solid: as observed. Orange: as the model predicts it.")
        lines.append(describe_colors(shows))
    for error in errors:
        if error.name == "cell":
            mean = error.mean * error.scale
            lines.append(f"Mean cell error of the final poses: {mean:.1f} {error.unit}")
    if predictions and overhanging:
        lines.append(f"These errors have {options.describe_overhanging(overhanging)}")
    found = {
        "kind": "pushes",
        "object": target.obj.name,
        "pushes": [seen.name for seen in picked],
        "errors": [vars(error) for error in errors],
    }
    return found, lines


def _describe_several(
    targets: Sequence[options.Target], picked: PushLog, predictions: list[Prediction] | None
) -> tuple[dict[str, Any], list[str]]:
    """Says the same of pushes of several objects, of which only the cell error is summed up."""
    found: dict[str, Any] = {"kind": "pushes", "objects": list(picked.names)}
    found["pushes"] = [seen.name for seen in picked]
    lines = [f"{', '.join(picked.names)}: {count_noun(len(picked), 'push')}"]
    if predictions is not None:
        objects = [target.obj for target in targets]
        errors = [
            calc_cell_errors(objects, each.at_observations[-1], seen.final_pose)
            for each, seen in zip(predictions, picked, strict=True)
            if len(seen.t_observed)
        ]
        found["cell_errors"] = errors
        lines.append("Solid: as observed. Orange: as the models predict it.")
        lines.append(f"Mean cell error of the final poses: {np.mean(errors) * MM_PER_M:.1f} mm")
    return found, lines


def predict_pushes(targets: Sequence[options.Target], picked: PushLog) -> list[Prediction] | None:
    """Predicts pushes by learned models; None where not all objects are learned.

    The friction of several objects on each other is the default one, for a model's file does not
    hold it.
    """
    if any(target.model is None for target in targets):
        return None
    options.compile_kernels()
    objects = [target.obj for target in targets]
    parameters = [target.params for target in targets]
    physics = targets[0].make_physics("auto") if len(targets) == 1 else None
    return predict(Model(objects, parameters, physics), picked)


def pick_pushes(path: Path, log: PushLog, names: list[str] | None) -> PushLog:
    """Picks the pushes with some names, or all pushes, of a log that was read from a file."""
    known = [seen.name for seen in log]
    for name in names or ():
        if name not in known:
            raise ViewError(f"--push: {path} has no push {name!r}; it has {', '.join(known)}")
    return log.subset([i for i, name in enumerate(known) if not names or name in names])
