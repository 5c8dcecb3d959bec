"""Players of `gridpush/PushTHidden-v0`."""

import numpy as np
import pytest

from gridpush_drake.bench.pusht.experiments import STUDY
from gridpush_drake.bench.pusht.strokes import (
    EVEN,
    LEARNED,
    PLAYERS,
    TRUE,
    PrimitiveEpisode,
    StrokesPlayed,
    calc_coverage,
    play_strokes,
    tabulate_strokes,
)
from gridpush_drake.gym.games import make_t


def test_who_knows_more_predicts_better():
    played = {player: play_strokes(PrimitiveEpisode(10001, player)) for player in PLAYERS}
    assert played[TRUE].reached
    assert played[LEARNED].prediction_error < 0.5 * played[EVEN].prediction_error
    assert played[TRUE].prediction_error < played[LEARNED].prediction_error
    assert played[LEARNED].error < played[EVEN].error
    assert all(each.strokes <= 4 for each in played.values())


def test_coverage_is_1_at_the_goal_and_0_far_away():
    t = make_t()
    goal = np.array([0.1, 0.2, 0.4])
    assert calc_coverage(t, goal, goal) == pytest.approx(1.0)
    assert calc_coverage(t, goal + [1.0, 0.0, 0.0], goal) == 0.0


def make_played(player, seed, error):
    return StrokesPlayed(
        player=player,
        seed=seed,
        reached=error < 0.005,
        error=error,
        coverage=0.9,
        strokes=4,
        prediction_error=error,
    )


def test_the_table_sets_players_side_by_side_and_pairs_their_episodes():
    errors = {
        LEARNED: [0.001, 0.002, 0.003],
        EVEN: [0.011, 0.022, 0.033],
        TRUE: [0.001, 0.001, 0.001],
    }
    played = [make_played(player, i, each[i]) for player, each in errors.items() for i in range(3)]
    table = tabulate_strokes(played)
    assert [row[0] for row in table.rows] == list(PLAYERS)
    assert table.rows[0][2].startswith("3 (")
    assert table.rows[1][2].startswith("0 (")
    assert table.rows[1][4].mean == pytest.approx(22.0)
    assert "20.00 (" in table.notes[-1]


def test_the_study_makes_an_episode_of_each_seed_and_player():
    jobs = STUDY.make_jobs(STUDY.options(episodes=2, strokes=True, seed=7))
    assert {(job.seed, job.player) for job in jobs} == {
        (seed, player) for seed in (7, 8) for player in PLAYERS
    }
