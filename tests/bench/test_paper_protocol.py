import json
from dataclasses import replace

import numpy as np
import pytest
from shapely import Point

from gridpush_drake.bench import paper
from gridpush_drake.bench.data.protocol import (
    FINGER_RADIUS,
    PUSH_DURATION,
    PUSH_SPEED,
    make_case,
    make_protocol,
    make_pushes,
    place_disc,
)
from gridpush_drake.bench.paper import PaperScore
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import GridPushError, OutputError
from gridpush_drake.identification.model import Model
from gridpush_drake.jobs.run import Execution
from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior
from gridpush_drake.objects.object_file import find_shipped_object, list_shipped_objects
from gridpush_drake.report.table import Mean, calc_interval
from tests.helpers.random_objects import make_random_object
from tests.helpers.shared_data import shared_data

OBJECTS = ("book", "box", "hammer", "snack", "windex")
ROWS, COLUMNS = 60, 90


@pytest.fixture
def made_folder(tmp_path):
    """The protocol's form with one mask of our own: an L, its foot another part."""
    mask = np.zeros((ROWS, COLUMNS), np.uint8)
    mask[10:50, 20:40] = 1
    mask[35:50, 20:80] = 2
    (tmp_path / "ell_label.pgm").write_bytes(b"P5 %d %d 255\n" % (COLUMNS, ROWS) + mask.tobytes())
    pushes = list(range(10))
    splits = {
        str(n): [{"train": pushes[i : i + n], "test": pushes[i + n :]} for i in range(2)]
        for n in (1, 5)
    }
    content = {
        "masses_by_label": {"ell": [[1.0, 3.0], [4.0, 0.5]]},
        "splits": splits,
        "metres_per_pixel": {"simulated": 0.002},
    }
    (tmp_path / "protocol.json").write_text(json.dumps(content))
    return tmp_path


@pytest.mark.parametrize("seed", range(20))
def test_a_placed_disc_touches_and_nothing_is_nearer(seed):
    rng = np.random.default_rng(seed)
    obj = make_random_object(rng, n=12)
    left, bottom, right, top = obj.outline.bounds
    x, side = rng.uniform(left, right), rng.choice([-1, 1])
    y = place_disc(obj.edges, x, side, FINGER_RADIUS)
    assert obj.outline.distance(Point(x, y)) == pytest.approx(FINGER_RADIUS, abs=1e-12)
    beyond = np.linspace(y, side * (abs(top) + abs(bottom) + FINGER_RADIUS), 50)[1:]
    assert min(obj.outline.distance(Point(x, at)) for at in beyond) > FINGER_RADIUS


def test_reads_the_protocol():
    protocol = make_protocol(shared_data("masks"))
    assert set(protocol.masks) == set(OBJECTS)
    assert set(protocol.masses) == {*OBJECTS, *list_shipped_objects()}
    assert all(len(sets) == 10 and min(map(min, sets)) >= 0.1 for sets in protocol.masses.values())
    assert protocol.meters_per_pixel == 0.001
    for count, splits in protocol.splits.items():
        assert len(splits) == 10
        for split in splits:
            assert len(split.train) == count
            assert sorted(split.train + split.test) == list(range(10))


def test_draws_the_protocol():
    protocol, other = make_protocol(seed=3), make_protocol(seed=4)
    assert protocol == make_protocol(seed=3)
    assert set(protocol.masses) == set(list_shipped_objects())
    for name, sets in protocol.masses.items():
        parts = len(np.unique(GridObject.from_yaml(find_shipped_object(name)).labels))
        assert np.shape(sets) == (10, parts)
        assert 0.1 <= np.min(sets) < 1 < 4 < np.max(sets) <= 5.0
        assert sets != other.masses[name]
    assert list(protocol.splits) == [1, 2, 3, 4, 5]
    for count, splits in protocol.splits.items():
        assert len(splits) == 10
        for split in splits:
            assert len(split.train) == count
            assert sorted(split.train + split.test) == list(range(10))


@pytest.mark.parametrize("name", list_shipped_objects())
def test_ten_pushes_of_shipped_objects_are_as_many_millimeters_apart(name):
    obj = GridObject.from_yaml(find_shipped_object(name))
    width = round(1e3 * np.ptp(obj.outline.exterior.xy[0]))
    pushes = make_pushes(obj, width)
    for half in (pushes[:5], pushes[5:]):
        apart = np.diff([push.start[0] for push in half])
        np.testing.assert_allclose(apart, 1e-3 * (width // 5), rtol=0.01)
    case = make_case(make_protocol(), name, mass_set=3)
    assert [seen.push.start.tolist() for seen in case.log] == [
        push.start.tolist() for push in pushes
    ]
    motions = [simulate(Model(obj), push) for push in pushes]
    assert max(abs(motion.gaps[0]) for motion in motions) < 1e-12


@pytest.mark.parametrize("name", OBJECTS)
def test_ten_pushes_touch_at_their_start(name):
    case = make_case(make_protocol(shared_data("masks")), name, mass_set=3)
    assert len(case.log) == 10
    starts = np.array([seen.push.start for seen in case.log])
    for side, half in ((1, starts[:5]), (-1, starts[5:])):
        assert (side * half[:, 1] > 0).all()
        np.testing.assert_allclose(np.diff(half[:, 0], n=2), 0, atol=1e-12)
        assert np.ptp(half[:, 0]) == pytest.approx(
            0.8 * np.ptp(case.obj.outline.exterior.xy[0]), rel=0.02
        )
    for i, seen in enumerate(case.log):
        np.testing.assert_allclose(seen.push.velocity, [0, -PUSH_SPEED if i < 5 else PUSH_SPEED])
        assert seen.push.duration == PUSH_DURATION
        np.testing.assert_allclose(seen.t_observed, np.arange(1, 21) * 0.1)
        motion = simulate(Model(case.obj), seen.push, seen.pose)
        assert abs(motion.gaps[0]) < 1e-12
        assert motion.status == "ok"


def test_the_identifier_sees_neither_parts_nor_masses(made_folder):
    case = make_case(make_protocol(made_folder), "ell", mass_set=0)
    assert (case.obj.labels == 1).all() and not case.obj.prior.uniform_parts
    shown = make_case(make_protocol(made_folder), "ell", mass_set=0, show_parts=True)
    assert set(shown.obj.labels) == {1, 2} and shown.obj.prior.uniform_parts
    assert shown.log[0].final_pose.tolist() == case.log[0].final_pose.tolist()
    told = make_case(
        make_protocol(made_folder), "ell", mass_set=0, show_parts=True, density_spread=1.5
    )
    assert told.log[0].final_pose.tolist() == case.log[0].final_pose.tolist()
    true = make_protocol(made_folder).masses["ell"][0]
    off = np.log([one.density for one in told.obj.prior.materials]) - np.log(true)
    assert (np.abs(off) > 0).all() and (np.abs(off) < 5 * np.log(1.5)).all()
    assert {one.spread for one in told.obj.prior.materials} == {1.5}
    assert case.obj.prior == PhysicalPrior()


def test_mass_sets_differ(made_folder):
    first, second = (make_case(make_protocol(made_folder), "ell", mass_set=i).log for i in (0, 1))
    assert np.abs(first[0].final_pose - second[0].final_pose).max() > 1e-3


def test_says_where_the_data_should_be(tmp_path):
    with pytest.raises(
        GridPushError, match=r"nowhere.*is no folder; expected a clone of GitHub changkyu/rss2020"
    ):
        make_protocol(tmp_path / "nowhere")
    with pytest.raises(GridPushError, match=r"holds no mask; expected files NAME_label\.pgm"):
        make_protocol(tmp_path)


def test_masks_without_a_protocol_get_drawn_ones(made_folder):
    (made_folder / "protocol.json").unlink()
    protocol = make_protocol(made_folder)
    assert np.shape(protocol.masses["ell"]) == (10, 2)
    assert protocol.splits == make_protocol().splits


@pytest.mark.parametrize("content", ["{", "[]", '{"splits": {}}', '{"masses_by_label": 3}'])
def test_refuses_another_file(made_folder, content):
    (made_folder / "protocol.json").write_text(content)
    with pytest.raises(GridPushError, match=r"protocol\.json.*masses_by_label"):
        make_protocol(made_folder)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"objects": ["spoon"]}, "spoon"),
        ({"methods": ["guess"]}, "guess"),
        ({"methods": []}, "methods"),
        ({"sets": 3}, "mass sets"),
        ({"budget": 4}, "budget"),
    ],
)
def test_refuses_what_it_cannot_do(made_folder, changes, message):
    with pytest.raises(GridPushError, match=message):
        paper.STUDY.run(data=made_folder, **{"sets": 1} | changes)


def test_a_small_run(made_folder, tmp_path):
    figure, told = tmp_path / "curve.png", []
    methods = ("paper", "random_search")
    execution = Execution(workers=0, report=lambda *what: told.append(what))
    chosen = {"data": made_folder, "methods": methods, "figure": figure}
    tables = paper.STUDY.run(sets=2, objects=("ell",), budget=20, execution=execution, **chosen)
    by_method, by_budget = tables
    assert by_method.columns == ("method", "ell", "all", "simulations")
    assert [row[0] for row in by_method.rows] == ["uniform prior", *methods]
    assert [row[-1] for row in by_method.rows] == [0, 20, 20]
    assert by_budget.columns == ("method", "at most 5", "at most 7", "at most 20")
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert told == [
        ("", 0, 2),
        *((f"ell, mass set {i}, 5 training pushes", i + 1, 2) for i in range(2)),
    ]
    with pytest.raises(OutputError, match="exists"):
        paper.STUDY.run(sets=1, **chosen)


def test_refuses_an_unknown_kind_of_figure(made_folder, tmp_path):
    with pytest.raises(OutputError, match=r"\.png"):
        paper.STUDY.run(data=made_folder, sets=1, figure=tmp_path / "curve.doc")


@pytest.mark.slow
def test_workers_do_not_matter(made_folder):
    options = {
        "data": made_folder,
        "sets": 2,
        "objects": ["ell"],
        "methods": ("paper", "weighted_sampling"),
        "budget": 50,
    }
    one, two = (paper.STUDY.run(execution=Execution(workers=count), **options) for count in (0, 2))
    assert one == two


def make_scores():
    one = PaperScore("a", 0, 5, "default", 100, 80, 0.001)
    return [
        replace(one, name=name, mass_set=mass_set, training=training, method=method, error=error)
        for training in (1, 5)
        for method, base in (("default", 0.001), ("uniform prior", 0.01))
        for name, mass_set, error in (
            ("a", 0, base),
            ("a", 1, 3 * base),
            ("b", 0, 5 * base),
            ("b", 1, 7 * base),
        )
    ]


def test_tables_of_scores():
    scores = make_scores()
    table = paper.tabulate_methods(scores, ["a", "b"], ["uniform prior", "default"], 5, 100)
    shown = [table.format(value) for value in table.rows[1]]
    assert shown == [
        "default",
        "2.00 (1.00 to 3.00)",
        "6.00 (5.00 to 7.00)",
        "4.00 (3.00 to 5.00)",
        "80",
    ]
    mean = table.to_dict()["rows"][1][3]
    assert mean == pytest.approx({"mean": 4.0, "low": 3.0, "high": 5.0})
    table = paper.tabulate_training(scores, ["a", "b"], "default", 100)
    assert [row[0] for row in table.rows] == [1, 5]
    assert table.format(table.rows[0][-2]) == "40.00 (30.00 to 50.00)"


def test_interval():
    rng = np.random.default_rng(0)
    values = rng.normal(3.0, 1.0, 200)
    interval = calc_interval(values)
    assert interval.mean == pytest.approx(values.mean())
    assert interval.high - interval.low == pytest.approx(
        2 * 1.96 * values.std() / np.sqrt(200), rel=0.05
    )
    assert calc_interval([0.002, 0.002], scale=1000.0) == Mean(2.0)
