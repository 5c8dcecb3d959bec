import pytest

from gridpush_drake.bench.planning import run
from gridpush_drake.bench.planning_protocol import (
    OVERHANG,
    list_objects,
    make_hidden,
    read_planning_object,
    read_planning_protocol,
)
from gridpush_drake.bench.planning_tables import LEARNING, TRUE
from gridpush_drake.errors import GridPushError
from tests.helpers.shared_data import shared_data


@pytest.fixture
def masks():
    return shared_data("masks")


def test_every_object_may_lie_where_the_protocol_says(masks):
    protocol = read_planning_protocol(masks)
    assert protocol.pairs.shape == (10, 2, 3)
    assert len(list_objects(protocol)) == 14
    for name in list_objects(protocol):
        obj = read_planning_object(protocol, name)
        assert make_hidden(protocol, name, 3).n == obj.n <= 127
        for pose in protocol.pairs.reshape(-1, 3):
            assert protocol.surface.contains_cells(obj, pose, -OVERHANG)


def test_decisions_are_near_the_exhaustive_search_s(masks):
    (table,) = run(masks, objects=["snack"], quick=True, parts=("contact",), workers=1, progress=lambda _: None)
    assert [row[0] for row in table.rows] == ["snack", "all"]
    row = dict(zip(table.columns, table.rows[0], strict=True))
    assert row["decisions"] == 3
    assert row["simulations"] <= 44
    assert row["exhaustive simulations"] >= 420
    assert row["worst gap, mm"] < 5


@pytest.mark.slow
def test_runs_reach_their_goals(masks):
    (table,) = run(
        masks, objects=["snack"], quick=True, parts=("push",), modes=(LEARNING, TRUE), workers=1,
        progress=lambda _: None,
    )  # fmt: skip
    done = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
    assert [(row["model"], row["object"]) for row in done] == [
        (LEARNING, "snack"), (LEARNING, "all"), (TRUE, "snack"), (TRUE, "all")
    ]  # fmt: skip
    assert all(row["success, %"] == 100 and row["off the table"] == 0 for row in done)
    assert done[2]["later, mm"] < done[0]["first prediction, mm"]


def test_refuses(masks, tmp_path):
    with pytest.raises(GridPushError, match="toaster"):
        run(masks, objects=["toaster"])
    with pytest.raises(GridPushError, match="sets"):
        run(masks, sets=11)
    with pytest.raises(GridPushError, match=r"protocol\.json"):
        run(tmp_path)
