"""What the demo leaves in its folder: what all tasks write, and what identifying does."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from pydrake.geometry import Meshcat

from gridpush_drake.cli.recording_legend import describe_scale, list_estimate_marks
from gridpush_drake.files import write_whole
from gridpush_drake.identification.learning import describe_prior
from gridpush_drake.identification.model_file import write_model
from gridpush_drake.identification.prediction import calc_mean_cell_error
from gridpush_drake.identification.result import Identification
from gridpush_drake.multibody.cell_colors import CellColors
from gridpush_drake.multibody.ground_truth import describe_truth
from gridpush_drake.multibody.meshcat_server import write_recording
from gridpush_drake.multibody.recording_overlay import Mark, Overlay, Phase
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.report.page import ReportSummary, make_report
from gridpush_drake.station.identify_task import IdentifyTaskRecord
from gridpush_drake.station.limit_monitor import LimitReport
from gridpush_drake.station.scenario import PushScenario, write_scenario

FILES = (
    "report.html",
    "recording.html",
    "model.yaml",
    "object.yaml",
    "pushes.csv",
    "held_out.csv",
    "truth.yaml",
    "scenario.yaml",
)


def write_demo(
    folder: Path,
    scenario: PushScenario,
    record: IdentifyTaskRecord,
    meshcat: Meshcat,
    force: bool,
) -> list[Path]:
    """Writes what an experiment came to.

    The model is the station's own: that which `gridpush identify` makes of object.yaml and pushes.csv.

    Args:
        folder: where; it exists.
        scenario: of the experiment.
        record: of the experiment; what it was too short for is not written.
        meshcat: with its recording.
        force: whether existing files may be replaced.

    Returns:
        The files written, in the order of FILES.

    Raises:
        OutputError: a file exists and `force` is not set, or it cannot be written.
    """
    report, _, model, _, pushes, kept_back, _, _ = (folder / name for name in FILES)
    overlay = make_overlay(record.obj, list_phases(record))
    written = write_setting(folder, scenario, record.obj, record.truth, meshcat, overlay, force)
    training, held_out = record.training_log, record.held_out_log
    if record.estimates:
        result = record.estimates[-1]
        training.write_csv(pushes, force)
        write_model(model, result, force)
        learning = calc_learning(record, result, held_out) if len(held_out) else None
        page = make_report(result, training, held_out if len(held_out) else None, record.truth, learning)
        write_whole(report, page, force)
        written += [pushes, model, report]
    if len(held_out):
        held_out.write_csv(kept_back, force)
        written.append(kept_back)
    return [folder / name for name in FILES if folder / name in written]


def list_phases(record: IdentifyTaskRecord) -> list[Phase]:
    """What the robot did when, for the recording."""
    phases = []
    for time, status in record.phases:
        number = status.executed + (not status.ready)
        kind = "Push" if number <= record.training else "Held-out push"
        title = "Looking at the object" if status.ready else f"{kind} {number}: {status.phase}"
        detail = "" if number <= record.training else "Predicted only, to test what was learned."
        phases.append(Phase(time, title, detail))
    return phases


def make_overlay(obj: GridObject, phases: Sequence[Phase], marks: Sequence[Mark] = ()) -> Overlay:
    """What stands beside the recording of a task; `marks` are its own besides the estimate's."""
    return Overlay(describe_scale(obj, CellColors()), (*list_estimate_marks(), *marks), tuple(phases))


def write_setting(
    folder: Path,
    scenario: PushScenario,
    obj: GridObject,
    truth: CellParameters,
    meshcat: Meshcat,
    overlay: Overlay,
    force: bool,
) -> list[Path]:
    """Writes what every task has: recording.html, object.yaml, truth.yaml, scenario.yaml; see `write_demo`."""
    names = ("recording.html", "object.yaml", "truth.yaml", "scenario.yaml")
    recording, object_file, hidden, setting = written = [folder / name for name in names]
    write_recording(meshcat, recording, force, overlay)
    obj.write_yaml(object_file, force=force)
    write_whole(hidden, yaml.safe_dump(describe_truth(obj, truth), sort_keys=False), force)
    write_scenario(setting, scenario, force)
    return written


def write_learned(
    folder: Path, log: PushLog, found: Identification, truth: CellParameters, story: ReportSummary, force: bool
) -> list[Path]:
    """Writes what tasks that learn on the way have besides: pushes.csv, model.yaml, report.html; see `write_demo`."""
    pushes, model, report = written = [folder / name for name in ("pushes.csv", "model.yaml", "report.html")]
    used = log.subset([i for i, seen in enumerate(log) if seen.name in found.push_names])
    log.write_csv(pushes, force)
    write_model(model, found, force)
    write_whole(report, make_report(found, used, truth=truth, story=story), force)
    return written


def describe_limit_report(limit_report: LimitReport) -> dict[str, Any]:
    """How the robot behaved, for JSON."""
    return {
        "position_share": limit_report.position_share,
        "velocity_share": limit_report.velocity_share,
        "torque_share": limit_report.torque_share,
        "tracking_error": limit_report.tracking_error,
        "touched": sorted(map(list, limit_report.touched)),
    }


def calc_learning(record: IdentifyTaskRecord, result: Identification, held_out: PushLog) -> list[float]:
    """Mean cell error of the held-out pushes, m, before the first push and after each."""
    estimates = [describe_prior(record.obj), *record.estimates]
    return [calc_mean_cell_error(record.obj, found.params, held_out, result.regime) for found in estimates]
