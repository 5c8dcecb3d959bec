from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gridpush_drake.bench.grasp import (
    STUDY,
    GraspBenchOptions,
    GraspEpisode,
    tabulate,
    tabulate_episodes,
)
from gridpush_drake.bench.study import Done
from gridpush_drake.cli.main import main
from gridpush_drake.errors import GridPushError, ObjectError
from gridpush_drake.station.campaign.episodes import (
    DROPPED_OUTCOME,
    GAVE_UP,
    EpisodeJob,
)
from gridpush_drake.station.schema.scenario_file import parse_scenario, read_scenario

HELD = GraspEpisode("pliers", 0, "held", "It was lifted.", "held", 6, 4, 2, 0.1, 0.002, 60.0, 30.0)


def test_objects_of_which_nothing_is_told_are_those_of_the_shipped_scenario():
    for unknown, name in ((False, "grasp"), (True, "grasp_unknown_inertia")):
        job = STUDY.make_jobs(GraspBenchOptions(unknown_inertia=unknown))[0]
        scenario = parse_scenario(Path("scenario.yaml"), job.scenario)
        shipped = read_scenario(name)
        assert scenario.unknown_inertia == unknown
        assert (scenario.truth, scenario.pregrasp) == (shipped.truth, shipped.pregrasp)
        assert scenario.truth.total_mass == ([0.1, 3.0] if unknown else None)


def test_runs_differ_in_mass_where_it_is_drawn():
    options = GraspBenchOptions(objects=("pliers", "claw_hammer"), seeds=3, seed=10)
    seeds = [job.seed for job in STUDY.make_jobs(options)]
    assert seeds == [10, 11, 12, 10, 11, 12]
    jobs = STUDY.make_jobs(replace(options, unknown_inertia=True))
    assert [job.object for job in jobs] == ["pliers"] * 3 + ["claw_hammer"] * 3
    assert sorted(job.seed for job in jobs) == list(range(10, 16))


def test_the_table_says_which_objects_could_be_held():
    runs = [replace(HELD, could_be_held=True), replace(HELD, outcome=GAVE_UP, could_be_held=False)]
    table = tabulate_episodes(runs, ["pliers"])
    row = dict(zip(table.columns, table.rows[-1], strict=True))
    assert (row["runs"], row["could be held"], row["held"]) == (2, 1, 1)
    assert any("too heavy" in note for note in table.notes)
    # of objects that were told there is nothing to say
    assert "could be held" not in tabulate_episodes([HELD], ["pliers"]).columns


def test_the_table_counts_what_happened():
    scores = [
        HELD,
        replace(
            HELD, seed=1, pokes=6, raised=0.09, center_of_mass_error=0.004, duration=80.0, wall=50.0
        ),
        replace(
            HELD,
            seed=2,
            status="failed",
            message="No safe way.",
            outcome=GAVE_UP,
            pokes=8,
            slides=5,
            wall=10.0,
        ),
        replace(
            HELD,
            object="toolbox",
            status="dropped",
            message="It fell.",
            outcome=DROPPED_OUTCOME,
            raised=-0.7,
            slides=1,
        ),
        replace(
            HELD,
            object="toolbox",
            seed=1,
            status="stuck",
            message="Nothing.",
            outcome=GAVE_UP,
            duration=61.0,
        ),
    ]
    scores[2] = replace(scores[2], raised=0.0)
    scores[-1] = replace(
        scores[-1], pokes=0, slides=0, center_of_mass_error=None, raised=0.0, wall=40.0
    )
    table = tabulate_episodes(scores, ["pliers", "toolbox"])
    rows = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
    assert [row["object"] for row in rows] == ["pliers", "toolbox", "all"]
    counts = [(row["runs"], row["held"], row["dropped"], row["given up"]) for row in rows]
    assert counts == [(3, 2, 0, 1), (2, 0, 1, 1), (5, 2, 1, 2)]
    assert [row["pokes"] for row in rows] == pytest.approx([6.0, 2.0, 4.4])
    assert [row["slides"] for row in rows] == pytest.approx([3.0, 0.5, 2.0])
    assert [row["raised, mm"] for row in rows] == pytest.approx([95.0, np.nan, 95.0], nan_ok=True)
    assert [row["CoM error, mm"] for row in rows] == pytest.approx([8 / 3, 2.0, 2.5])
    assert [row["simulated, s"] for row in rows] == pytest.approx([200 / 3, 60.5, 64.2])
    assert [row["wall, s"] for row in rows] == pytest.approx([30.0, 35.0, 32.0])
    assert [note for note in table.notes if "seed" in note] == [
        "pliers, seed 2: failed. No safe way.",
        "toolbox, seed 0: dropped. It fell.",
        "toolbox, seed 1: stuck. Nothing.",
    ]


def test_what_was_learned_has_a_table_where_objects_were_weighed():
    weighed = replace(
        HELD,
        mass_error=-0.02,
        friction_error=0.01,
        mass_holds=True,
        center_holds=True,
        friction_holds=False,
    )
    runs = [weighed, replace(weighed, seed=1, mass_error=0.04, mass_holds=False), HELD]
    options = replace(STUDY.options(), objects=("pliers",))
    done = Done([(EpisodeJob(object=run.object, seed=run.seed, scenario=""), run) for run in runs])
    _, learned = tabulate(options, done)
    row = dict(zip(learned.columns, learned.rows[-1], strict=True))
    assert (row["runs"], row["mass off, %"], row["CoM off, mm"]) == (2, pytest.approx(3.0), 2.0)
    inside = [row[f"{what} inside"].split(" (")[0] for what in ("mass", "CoM", "friction")]
    assert inside == ["1", "2", "0"]
    # of objects that were told there is nothing to say
    assert len(tabulate(options, Done(done.pairs[2:]))) == 1


def test_refuses_what_makes_no_sense():
    with pytest.raises(ObjectError, match="brick"):
        STUDY.run(objects=("claw_hammer", "brick"), seeds=1)
    with pytest.raises(GridPushError, match="objects: none"):
        STUDY.run(objects=(), seeds=1)
    with pytest.raises(GridPushError, match="seeds: none"):
        STUDY.run(objects=("claw_hammer",), seeds=0)


def test_the_command_refuses_an_unknown_object(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["bench", "grasp", "--objects", "brick", "--quick"])
    assert ended.value.code == 2
    assert "brick" in capsys.readouterr().err
