"""What came of the demo, in numbers and in words."""

from pathlib import Path
from typing import Any

import numpy as np

from gridpush_drake.cli.console import MM, print_line
from gridpush_drake.cli.demo_files import describe_limit_report
from gridpush_drake.identification.prediction import calc_mean_cell_error
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.station.identify_task import FINISHED, IdentifyTaskRecord


def judge(record: IdentifyTaskRecord) -> dict[str, Any]:
    """Errors before and after learning, lengths in m, and how the robot behaved; for JSON."""
    verdict: dict[str, Any] = {
        "object": record.obj.name,
        "status": record.status,
        "message": record.message,
        "pushes": len(record.training_log),
        "held_out": len(record.held_out_log),
        "simulated_seconds": record.duration,
        "limit_report": describe_limit_report(record.limit_report),
    }
    if record.estimates:
        verdict["learned"] = record.estimates[-1].message
        verdict["before"] = _compare(record, CellParameters.uniform(record.obj))
        verdict["after"] = _compare(record, record.estimates[-1].params)
    return verdict


def print_verdict(verdict: dict[str, Any], written: list[Path]) -> None:
    """Prints a verdict, and what was written."""
    name = verdict["object"].replace("_", " ")
    if verdict["status"] != FINISHED:
        print_line(verdict["message"])
    if "after" in verdict:
        print_line(f"The {name} after {verdict['pushes']} pushes: {verdict['learned']}")
        before, after = verdict["before"], verdict["after"]
        rows = [("error of the center of mass", "center_of_mass_error")]
        if verdict["held_out"]:
            rows.insert(0, (f"error of {verdict['held_out']} pushes held out", "held_out_cell_error"))
        for what, key in rows:
            print_line(
                f"  {what}: {before[key] * MM:.1f} mm assuming an even object, {after[key] * MM:.1f} mm as learned"
            )
    else:
        print_line(f"Nothing was learned about the {name}.")
    folder, names = written[0].parent, [path.name for path in written]
    print_line(f"\nIn {folder}: {', '.join(names)}.")


def _compare(record: IdentifyTaskRecord, params: CellParameters) -> dict[str, float]:
    obj, truth = record.obj, record.truth
    regime = record.estimates[-1].regime
    return {
        "held_out_cell_error": calc_mean_cell_error(obj, params, record.held_out_log, regime),
        "center_of_mass_error": float(np.linalg.norm(params.center_of_mass(obj) - truth.center_of_mass(obj))),
    }
