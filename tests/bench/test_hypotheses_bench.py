"""The bench of load hypotheses learns bodies with several sets of them, and compares the errors."""

import numpy as np
import pytest

from gridpush_drake.bench.truth import hypotheses as bench
from gridpush_drake.bench.truth.hypotheses import (
    ALL_HYPOTHESES,
    EVEN_MODEL,
    SMOOTH_FIELDS,
    HypothesisJob,
    HypothesisScore,
    make_sets,
    run_job,
    tabulate_scores,
)
from gridpush_drake.bench.truth.random_bodies import (
    MASS_RATIO,
    MAX_FRACTION,
    MIN_FRACTION,
    TOOLS_KIND,
    draw_part_masses,
    draw_tool,
)
from gridpush_drake.errors import GridPushError
from gridpush_drake.jobs.run import Execution


def test_a_body_is_learned_with_each_set(monkeypatch) -> None:
    chosen = {
        name: made for name, made in make_sets().items() if name in (ALL_HYPOTHESES, SMOOTH_FIELDS)
    }
    monkeypatch.setattr(bench, "make_sets", lambda: chosen)
    scores = run_job(HypothesisJob(TOOLS_KIND, seed=0, pushes=3))
    error = {score.hypotheses: score.error for score in scores}
    assert list(error) == [EVEN_MODEL, ALL_HYPOTHESES, SMOOTH_FIELDS]
    assert error[ALL_HYPOTHESES] < 0.5 * error[EVEN_MODEL]
    assert [score.covered for score in scores] == [None, True, True]


def test_tools_have_parts_of_the_sizes_and_weights_that_are_said() -> None:
    rng = np.random.default_rng(3)
    for _ in range(3):
        obj = draw_tool(rng)
        fractions = np.unique(obj.labels, return_counts=True)[1] / obj.n
        assert 2 <= len(fractions) <= 4 and fractions.min() >= MIN_FRACTION
        assert len(fractions) == 2 or fractions.max() <= MAX_FRACTION
        mass = draw_part_masses(obj, rng).mass
        assert MASS_RATIO[0] <= mass.max() / mass.min() <= MASS_RATIO[1]


def test_the_table_says_how_much_worse_it_is_without_a_hypothesis() -> None:
    names = list(make_sets())
    scores = [
        HypothesisScore(
            "tools", seed, name, 0.001 * (seed + 1) + 0.0005 * (name != ALL_HYPOTHESES), seed == 0
        )
        for seed in (0, 1)
        for name in (EVEN_MODEL, *names)
    ]
    (row,) = tabulate_scores(scores).rows
    assert row[:2] == ["tools", 2] and row[3].mean == pytest.approx(1.5)
    assert [cell.mean for cell in row[4:-1]] == pytest.approx([0.5] * (len(names) - 1))
    assert row[-1] == pytest.approx(50.0)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"kinds": ("jelly",)}, "kind: jelly"),
        ({"kinds": ("logs",)}, "kind: logs; expected --data DIR"),
        ({"kinds": ("tools",), "pushes": 10}, "pushes: 10; expected"),
    ],
)
def test_refuses_what_makes_no_sense(arguments, says) -> None:
    with pytest.raises(GridPushError, match=says):
        bench.STUDY.run(execution=Execution(workers=0), **arguments)
