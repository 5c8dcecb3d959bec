"""What the summaries of several kinds of tasks have in common: errors and counts, in words."""

from typing import Any

import numpy as np

from gridpush_drake.notebook import count as count_noun
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.station.tasks.task import TaskRecord
from gridpush_drake.units import MM_PER_M


def calc_center_error(record: TaskRecord, params: CellParameters) -> float:
    """Calculates the distance of an estimate's center of mass from the true one, m.

    The record is of a simulated run, in which the truth is known.
    """
    assert record.truth is not None
    estimated = params.center_of_mass(record.obj)
    true = record.truth.center_of_mass(record.obj)
    return float(np.linalg.norm(estimated - true))


def calc_center_errors(record: Any) -> dict[str, float]:
    """Calculates the errors of the center of mass, m, "before" and "after" learning.

    Before, the object is assumed to be even. The result is empty if nobody knows the truth.
    """
    if record.truth is None:
        return {}
    compared = {"before": CellParameters.uniform(record.obj), "after": record.estimates[-1].params}
    return {name: calc_center_error(record, params) for name, params in compared.items()}


def compare_errors(what: str, key: str, summary: dict[str, Any]) -> str:
    """Compares an error, m, in the summary before and after learning, in a line of words."""
    before = summary["before"][key] * MM_PER_M
    after = summary["after"][key] * MM_PER_M
    return f"  {what}: {before:.1f} mm assuming an even object, {after:.1f} mm as learned"


def count_pushes(pokes: int, slides: int) -> str:
    """Says how many pokes and slides were made."""
    return f"{count_noun(pokes, 'poke')} and {count_noun(slides, 'slide')}"
