import numpy as np
import pytest

from gridpush_drake.bench.data.protocol import (
    MAX_CELL_OVERHANG,
    draw_pairs,
    list_objects,
    make_hidden,
    make_planning_protocol,
    read_planning_object,
)
from gridpush_drake.bench.planning import LEARNING_MODEL, STUDY, TRUE_MODEL
from gridpush_drake.errors import GridPushError
from gridpush_drake.jobs.run import Execution
from gridpush_drake.objects.object_file import list_shipped_objects
from tests.helpers.shared_data import shared_data


@pytest.fixture
def masks():
    return shared_data("masks")


@pytest.mark.parametrize("seed", [None, 0])
def test_every_object_may_lie_where_the_protocol_says(seed):
    """Of the public data (None) as of those drawn by seed."""
    protocol = (
        make_planning_protocol(shared_data("masks"))
        if seed is None
        else make_planning_protocol(seed=seed)
    )
    assert protocol.pairs.shape == (10, 2, 3)
    assert len(list_objects(protocol)) == len(list_shipped_objects()) + (5 if seed is None else 0)
    for name in list_objects(protocol):
        obj = read_planning_object(protocol, name)
        assert make_hidden(protocol, name, 3).n == obj.n <= 127
        for pose in protocol.pairs.reshape(-1, 3):
            assert protocol.surface.contains_cells(obj, pose, -MAX_CELL_OVERHANG)


@pytest.mark.slow
def test_decisions_are_near_the_exhaustive_search_s(masks):
    (table,) = STUDY.run(
        data=masks, objects=("snack",), quick=True, part="contact", execution=Execution(workers=0)
    )
    assert [row[0] for row in table.rows] == ["snack", "all"]
    row = dict(zip(table.columns, table.rows[0], strict=True))
    assert row["decisions"] == 3
    assert row["simulations"] <= 44
    assert row["exhaustive simulations"] >= 420
    assert row["worst gap, mm"] < 5


@pytest.mark.slow
def test_runs_reach_their_goals(masks):
    (table,) = STUDY.run(
        data=masks, objects=("snack",), quick=True, part="push", modes=(LEARNING_MODEL, TRUE_MODEL),
        execution=Execution(workers=0),
    )  # fmt: skip
    done = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
    assert [(row["model"], row["object"]) for row in done] == [
        (LEARNING_MODEL, "snack"), (LEARNING_MODEL, "all"), (TRUE_MODEL, "snack"), (TRUE_MODEL, "all")
    ]  # fmt: skip
    assert all(row["success, %"] == 100 and row["off the table"] == 0 for row in done)
    assert done[2]["later, mm"] < done[0]["first prediction, mm"]


def test_what_is_drawn_depends_on_the_seed():
    first, again, other = (draw_pairs(seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.1


@pytest.mark.slow
def test_runs_without_data():
    (table,) = STUDY.run(
        objects=("pliers",), quick=True, part="contact", execution=Execution(workers=0)
    )
    assert [row[0] for row in table.rows] == ["pliers", "all"]
    assert dict(zip(table.columns, table.rows[0], strict=True))["decisions"] == 3


def test_refuses(tmp_path):
    with pytest.raises(GridPushError, match="toaster"):
        STUDY.run(objects=("toaster",))
    with pytest.raises(GridPushError, match="sets"):
        STUDY.run(sets=11)
    with pytest.raises(GridPushError, match=r"_label\.pgm, as of GitHub changkyu/rss2020_changkyu"):
        STUDY.run(data=tmp_path)
