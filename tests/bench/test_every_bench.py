"""What holds for every bench."""

import pickle
from dataclasses import dataclass, fields, replace
from importlib import import_module
from math import nan

import pytest

from gridpush_drake.bench import drake, paper, planning, real
from gridpush_drake.bench.paper import PaperScore
from gridpush_drake.bench.perception import experiments as perception
from gridpush_drake.bench.planning import Decision, Run
from gridpush_drake.bench.pregrasp import experiments as pregrasp
from gridpush_drake.bench.pregrasp.exploring import ExplorationScore, Trace
from gridpush_drake.bench.pregrasp.sliding import SlideScore
from gridpush_drake.bench.pregrasp.world import PreGraspOutcome
from gridpush_drake.bench.study import StudyOptions
from gridpush_drake.bench.worlds import plant
from gridpush_drake.cli.bench.command import describe_settings
from gridpush_drake.cli.bench.group import BENCHES
from gridpush_drake.errors import GridPushError
from gridpush_drake.jobs.results import make_key, open_results
from gridpush_drake.station.campaign import episodes as campaign


@dataclass(frozen=True)
class NumberedJob:
    number: int


@pytest.mark.parametrize("name", BENCHES)
def test_every_bench_is_declared_whole(name):
    if name == "gym":
        pytest.importorskip("gymnasium", reason="Gymnasium is in the extra `gym`")
    module, _, attribute = BENCHES[name].target.partition(":")
    study = getattr(import_module(module), attribute)
    assert study.name == name
    assert study.help == BENCHES[name].help
    for each in fields(study.options):
        assert (
            each.metadata.get("text") or each.name in study.options.__doc__ + StudyOptions.__doc__
        )
    options = study.options(quick=True, seed=7)
    try:
        jobs = study.make_jobs(study.shorten(options))
    except GridPushError as error:
        assert "pip install" in str(error)  # an extra is missing
        return
    assert bool(jobs) == bool(study.tasks)
    assert {type(job) for job in jobs} <= {task.job for task in study.tasks}
    assert len({make_key(job) for job in jobs}) == len(jobs)
    assert list(pickle.loads(pickle.dumps(jobs))) == list(jobs)
    assert all(task.describe(job) for task in study.tasks for job in jobs if type(job) is task.job)
    assert all(getattr(job, "seed", 7) >= 7 or getattr(job, "seeds", ()) for job in jobs)
    assert set(describe_settings(study, {"seed": 7, "force": True})) == {"seed"}


TRACE = Trace(3, nan, 1.5)


@pytest.mark.parametrize(
    ("function", "result"),
    [
        (paper.run_job, [PaperScore("a", 0, 5, "default", 100, 80, 0.1 + 0.2)]),
        (planning.run_job, [Decision("a", "gradient", 28, -1e-17, 0.3)]),
        (planning.run_job, [Run("a", "true", True, False, 3, "reached", nan, 0.1, 99, 1.0, 0.0)]),
        (real.run_job, [real.RealPushScore("a", 0, "poses", 5, (0.1, 0.2), (nan, 0.3))]),
        (pregrasp.run_job, SlideScore("a", "learned", PreGraspOutcome(True, False, 3, 2, "held"))),
        (
            pregrasp.run_job,
            ExplorationScore("a", "both directions", 0.02, TRACE, replace(TRACE, pokes=21)),
        ),
        (
            campaign.run_episode,
            campaign.EpisodeOutcome("a", 0, "held", "", "held", 5, 3, 2, nan, None, 30.0, 12.5),
        ),
        (
            drake.run_job,
            drake.StationScore(
                "a", 0, "finished", 8, 4, (0.1, 0.2, nan), (0.1, 0.2), 0.1, 0.5, 0, 9.0
            ),
        ),
        (plant.run_job, [plant.PlantScore("a", "free", 0, "none", 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)]),
    ],
)
def test_every_benchs_results_come_back_as_they_were(tmp_path, function, result):
    results = open_results(tmp_path / "kept.jsonl", "some", {})
    results.append(function, NumberedJob(1), result)
    again = open_results(tmp_path / "kept.jsonl", "some", {})
    found = again.find(function, [NumberedJob(0), NumberedJob(1)])
    assert list(found) == [1]
    assert repr(found[1]) == repr(result)


@pytest.mark.parametrize("study", [real.STUDY, perception.STUDY])
def test_an_object_given_twice_is_refused(study):
    with pytest.raises(GridPushError, match="objects: pliers, pliers; expected each once"):
        study.run(objects=("pliers", "pliers"))
