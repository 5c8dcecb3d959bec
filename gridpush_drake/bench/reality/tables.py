"""The tables of `gridpush bench reality`: one of single pushes, one of runs of several."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from gridpush_drake.bench.data.real_logs import CMU_RHO, DUBINS_LOG, MIT_LOG, SIMULATED_LOG
from gridpush_drake.bench.data.real_sets import MAX_SLIP, PUSH_COUNTS, RUN_COUNTS
from gridpush_drake.bench.real import calc_splits_mean
from gridpush_drake.bench.reality.scores import (
    EVEN_MODEL,
    PLANT_SPEED,
    SET_MODEL,
    STILL_MODEL,
    RealityJob,
    RealityScore,
    list_learned,
    read_job,
)
from gridpush_drake.pushes.importers.mit import read_model_errors
from gridpush_drake.report.table import Mean, Proportion, Table, Value
from gridpush_drake.units import DEG_PER_RAD, MM_PER_M, PERCENT_PER_ONE

REGIONS = (0.5, 0.9)
"""Probabilities of the regions whose coverage is tabulated."""

STABLE_COLUMNS = ("stable told, %", "by cone, %")
"""Columns of how many pushes are rightly called stable or not."""


def tabulate_pushes(jobs: Sequence[RealityJob], scores: Sequence[RealityScore]) -> Table:
    """Tabulates the errors of single pushes."""
    engines = jobs[0].engines
    rows: list[list[Value]] = []
    for job in _list_sets(jobs):
        repeated = None if job.kind == SIMULATED_LOG else read_job(job).calc_repeatability()
        for model, training in _list_models(job.kind):
            chosen = [
                s for s in scores if (s.name, s.model, s.training) == (job.name, model, training)
            ]
            means = [_calc_mean([s for s in chosen if s.engine == engine]) for engine in engines]
            ranks = [rank for one in chosen for rank in one.ranks]
            slips = [slip for one in chosen for slip in one.slips]
            rows.append(
                [
                    job.name,
                    model,
                    training,
                    *means,
                    None if repeated is None else MM_PER_M * repeated,
                    *(calc_percent([rank <= region for rank in ranks]) for region in REGIONS),
                    calc_percent([slip.predicted_stable == slip.stable for slip in slips]),
                    calc_percent([slip.cone_stable == slip.stable for slip in slips]),
                ]
            )
        if job.kind == MIT_LOG:
            own = _read_own(job.path)
            blank: list[None] = [None] * (len(engines) + len(REGIONS) + 2)
            rows.append([job.name, SET_MODEL, None, own, *blank])
    title = "Real pushes: held-out error, mm"
    notes = _list_notes(jobs)
    if jobs[0].kind == SIMULATED_LOG:
        title = "Simulated stand-in for real pushes: held-out error, mm"
        notes.insert(0, "Nothing here is real: pass real robots' pushes with --data.")
    regions = [f"in {PERCENT_PER_ONE * region:.0f} % region, %" for region in REGIONS]
    columns = ("set", "model", "training", *engines, "repeated", *regions, *STABLE_COLUMNS)
    return Table(title, columns, rows, notes, keys=3)


def _list_notes(jobs: Sequence[RealityJob]) -> list[str]:
    """Lists what must be known to read the table of pushes."""
    splits = len({job.split for job in jobs})
    return [
        f"Error |dxy| + rho |dtheta| of held-out pushes, rho = {MM_PER_M * CMU_RHO:.1f} mm; mean "
        f"over all that {splits} divisions held out, {jobs[0].test} each (of runs: all "
        "from one start), ± 95 % confidence (Student's t over pushes; what other pushes to learn "
        "from would change is not in it).",
        "Training: number of pushes that were learned from; of runs, the number of runs.",
        "Drake and MuJoCo have the same masses and frictions as ours. Drake's object is held to "
        "the table's plane, MuJoCo's is free on its feet; both are pushed at "
        f"{MM_PER_M * PLANT_SPEED:g} mm/s at least.",
        "The center of mass of the CMU's plates is told: they are even.",
        f"{SET_MODEL}: the mean error over all pushes of the file by another model, as the file "
        "says.",
        "Repeated: what the same push, or the end of the same run, differs by when it is made "
        "again, where that is known.",
        "In a region: how many held-out pushes end in the region that the learned model says to "
        "hold so many, with the Wilson interval.",
        "Stable told: of how many pushes by several tips it is said rightly whether the object "
        "goes with the pusher. The predicted end says so (two-point pushes: within 3 mm and 5°, "
        "and those who made them judged; runs: within 1.5 mm and 1.5°, and so it is judged); by "
        "cone: the motion cone, of an object that does not slip at all.",
    ]


def tabulate_runs(jobs: Sequence[RealityJob], scores: Sequence[RealityScore]) -> Table:
    """Tabulates where runs of several pushes end, and how far the object slips in them."""
    limits = MAX_SLIP[DUBINS_LOG]
    rows: list[list[Value]] = []
    for job in _list_sets(jobs):
        for model, training in _list_models(job.kind):
            chosen = [
                s for s in scores if (s.name, s.model, s.training) == (job.name, model, training)
            ]
            runs = [run for one in chosen for run in one.runs]
            slips = [slip for one in chosen for slip in one.slips]
            if not runs:
                continue
            within = [run.position <= limits[0] and run.angle <= limits[1] for run in runs]
            rows.append(
                [
                    job.name,
                    model,
                    training,
                    len(runs),
                    _average(MM_PER_M * run.position for run in runs),
                    _average(DEG_PER_RAD * run.angle for run in runs),
                    calc_percent(within),
                    _average(MM_PER_M * slip.seen for slip in slips),
                    _average(DEG_PER_RAD * slip.seen_angle for slip in slips),
                    _average(MM_PER_M * abs(slip.said - slip.seen) for slip in slips),
                    _average(
                        DEG_PER_RAD * abs(slip.said_angle - slip.seen_angle) for slip in slips
                    ),
                ]
            )
    notes = [
        "The whole run is predicted from where the object lies at its beginning; the runs from one "
        "start are held out, and the runs that were learned from begin elsewhere.",
        f"Near: the end is within {MM_PER_M * limits[0]:g} mm and {DEG_PER_RAD * limits[1]:g}°.",
        "Slip: how far the object is from where it would be, had it gone with the fingers since "
        "they lay flush, at the end of each push that was seen; and how far the slip that was said "
        "is off. ± 95 % confidence (Student's t).",
    ]
    columns = ("set", "model", "training", "runs", "end, mm", "end, °", "near, %")
    slip_columns = ("slip, mm", "slip, °", "slip off by, mm", "by, °")
    return Table("Runs of several pushes", (*columns, *slip_columns), rows, notes, keys=3)


def _average(values: Iterable[float]) -> Mean | None:
    """Calculates a mean and its interval; None of no values."""
    array = np.array(list(values))
    return calc_splits_mean(array) if len(array) else None


def calc_percent(right: Sequence[bool]) -> Mean | None:
    """Calculates how many are true, in percent, with the Wilson interval; None of none."""
    if not right:
        return None
    found = Proportion.of(sum(right), len(right))
    return Mean(
        PERCENT_PER_ONE * found.count / found.total,
        PERCENT_PER_ONE * found.low,
        PERCENT_PER_ONE * found.high,
    )


def _list_sets(jobs: Sequence[RealityJob]) -> list[RealityJob]:
    """Lists a job of each set."""
    return list({(job.name, job.kind, job.path): job for job in reversed(jobs)}.values())[::-1]


def _list_models(kind: str) -> list[tuple[str, int]]:
    """Lists what is believed of a set's object, and from how many pushes, or runs, that is."""
    counts = RUN_COUNTS if kind == DUBINS_LOG else PUSH_COUNTS
    learned = [(model, count) for count in counts for model in list_learned(kind)]
    return [(STILL_MODEL, 0), (EVEN_MODEL, 0), *learned]


def _calc_mean(chosen: Sequence[RealityScore]) -> Mean | None:
    """Calculates the mean over pushes, mm; None if a simulator did not predict with a model."""
    if not chosen:
        return None
    # A push that several divisions held out counts once, with its mean error
    by_push: dict[tuple[str, int], list[float]] = {}
    for score in chosen:
        # Each division of simulated pushes has pushes of its own
        of = str(score.split) if score.kind == SIMULATED_LOG else ""
        for number, error in zip(score.pushes, score.errors, strict=True):
            by_push.setdefault((of, number), []).append(MM_PER_M * error)
    return calc_splits_mean(np.array([np.mean(errors) for errors in by_push.values()]))


def _read_own(path: Path) -> Mean:
    """Reads the mean error of a set's own model, mm."""
    position, angle = read_model_errors(path)
    return Mean(MM_PER_M * (position + CMU_RHO * angle))
