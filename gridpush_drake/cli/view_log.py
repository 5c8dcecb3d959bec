"""The push log that `gridpush view` shows: its object, its pushes, and their predictions."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gridpush_drake.cli import options
from gridpush_drake.cli.console import count_noun
from gridpush_drake.cli.view_scene import describe_colors
from gridpush_drake.display.cell_colors import Shown
from gridpush_drake.errors import GridPushError
from gridpush_drake.files import exists, is_file
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.model_file import looks_like_model
from gridpush_drake.identification.prediction import Prediction, predict, summarize_errors
from gridpush_drake.objects.object_file import speak_name
from gridpush_drake.pushes.push_log import PushLog

MODEL_BESIDE = "model.yaml"
"""Name of the model that is looked for beside a push log; `gridpush demo` writes it there."""

OBJECT_BESIDE = "object.yaml"
"""Name of the object that is looked for beside a push log; `gridpush demo` writes it there."""


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
    beside = (log.parent / MODEL_BESIDE, log.parent / OBJECT_BESIDE)
    told = model_file or object_file or next((path for path in beside if is_file(path)), None)
    if not exists(log):
        raise ViewError(f"{log}: there is no such file")
    if told is None:
        raise ViewError(
            f"{log}: its object is unknown; expected --object, --model, or {MODEL_BESIDE} or "
            f"{OBJECT_BESIDE} beside it"
        )
    return options.load_target(str(told), largest_piece)


def describe_pushes(
    target: options.Target,
    picked: PushLog,
    predictions: list[Prediction] | None,
    shows: Shown,
) -> tuple[dict[str, Any], list[str]]:
    """Says which pushes are shown, and how well they are predicted; for machines and in lines."""
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


def predict_pushes(target: options.Target, picked: PushLog) -> list[Prediction] | None:
    """Predicts pushes by a learned model; None where nothing was learned."""
    if target.model is None:
        return None
    options.compile_kernels()
    return predict(Model(target.obj, target.params, target.make_physics("auto")), picked)


def pick_pushes(path: Path, target: options.Target, names: list[str] | None) -> PushLog:
    """Reads the pushes with some names, or all pushes, from a log."""
    log = options.load_log(path, target.obj, require_final=False)
    known = [seen.name for seen in log]
    for name in names or ():
        if name not in known:
            raise ViewError(f"--push: {path} has no push {name!r}; it has {', '.join(known)}")
    return log.subset([i for i, name in enumerate(known) if not names or name in names])
