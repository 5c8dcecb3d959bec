import numpy as np
import pytest
from scipy.io import savemat
from shapely import Polygon

from gridpush_drake.errors import PushLogError, PushLogWarning
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.importers.mit import MIT_SHAPES, MitImporter, read_model_errors
from tests.helpers.shared_data import shared_data
from tests.pushes.gaps import gaps

RECORD = {
    "init_pose_gt": [0.3, 0.1, 3.1],
    "final_pose_gt": [0.31, 0.12, -3.1],
    "final_pose_sim": [0.0, 0.0, 0.0],
    "init_tip_pt": [0.2, 0.1],
    "final_tip_pt": [0.23, 0.14],
}
FILE = {
    "record": [RECORD, RECORD, RECORD],
    "vel": 10.0,
    "avg_diff_disp": 0.003,
    "avg_diff_angle": 0.05,
}
MASS_PER_AREA = 0.8374 / 0.0081  # of rect1, kg/m^2

PUBLISHED_MASSES = {
    "rect1": 0.8374, "rect2": 1.045, "rect3": 1.2508, "tri1": 0.8028, "tri2": 0.9826, "tri3": 1.1326,
    "ellip1": 0.8937, "ellip2": 1.1104, "ellip3": 1.3338, "hex": 0.9827, "butter": 1.1974,
}  # fmt: skip
"""kg, from mcubelab/push-est-public: plates of one thickness, so mass tells area."""


def import_mit(path, **options):
    return MitImporter(**options).read(path)


def save(path, record=None, **changes):
    content = FILE | changes
    records = content.pop("record") if record is None else record
    cells = np.empty(len(records), dtype=object)
    cells[:] = records
    content.pop("record", None)
    savemat(path, {"record_all": cells} | {k: v for k, v in content.items() if v is not None})
    return path


def test_a_push(tmp_path):
    path = save(tmp_path / "steel_hex.mat")
    log, obj = import_mit(path)
    assert obj.name == "hex"
    assert obj.prior.pusher_radius == 0.00475
    assert obj.prior.total_mass is None
    assert [seen.name for seen in log] == ["push_1", "push_2", "push_3"]
    assert log.source == str(path)
    assert log.radius_given
    seen = log[0]
    assert seen.push.radius == 0.00475
    assert seen.push.duration == pytest.approx(5.0)
    np.testing.assert_array_equal(seen.push.t, [0, seen.push.duration])
    np.testing.assert_allclose(seen.push.xy, [[0.2, 0.1], [0.23, 0.14]])
    np.testing.assert_array_equal(seen.pose, RECORD["init_pose_gt"])
    np.testing.assert_allclose(seen.final_pose, [0.31, 0.12, 2 * np.pi - 3.1])
    np.testing.assert_array_equal(seen.t_observed, [seen.push.duration])
    assert seen.force is None


def test_a_single_push(tmp_path):
    assert len(import_mit(save(tmp_path / "x_rect1.mat", record=[RECORD]))[0]) == 1


def test_speed_of_the_file(tmp_path):
    assert import_mit(save(tmp_path / "x_rect1.mat", vel=20.0))[0][
        0
    ].push.duration == pytest.approx(2.5)
    assert import_mit(save(tmp_path / "y_rect1.mat", vel=None))[0][
        0
    ].push.duration == pytest.approx(5.0)
    with pytest.raises(PushLogError, match="vel is 0"):
        import_mit(save(tmp_path / "z_rect1.mat", vel=0.0))


def test_shape_from_argument_name_or_file(tmp_path):
    with pytest.warns(
        PushLogWarning, match=r"steel_hex.mat: taken for pushes of rect2, but its name says hex"
    ):
        assert import_mit(save(tmp_path / "steel_hex.mat"), shape="rect2")[1].name == "rect2"
    with pytest.warns(
        PushLogWarning, match=r"taken for pushes of hex, but its shape_id says rect1"
    ):
        assert import_mit(save(tmp_path / "steel_hex.mat", shape_id="rect1"))[1].name == "hex"
    assert import_mit(save(tmp_path / "steel_v10.mat", shape_id="rect1"))[1].name == "rect1"
    assert import_mit(save(tmp_path / "steel_v10.mat"), shape="rect1")[1].name == "rect1"
    own = GridObject.from_outline([[0, 0], [0.1, 0], [0, 0.1]], name="mine")
    assert import_mit(save(tmp_path / "nothing.mat"), obj=own)[1] is own


@pytest.mark.parametrize(("name", "shape"), [("a_cube", None), ("a_hex", "cube"), ("cube", None)])
def test_unknown_shapes_are_refused_with_the_known(tmp_path, name, shape):
    with pytest.raises(PushLogError) as raised:
        import_mit(save(tmp_path / f"{name}.mat"), shape=shape)
    for message in (f"{name}.mat", "'cube'", *MIT_SHAPES):
        assert message in str(raised.value)


def test_model_errors(tmp_path):
    assert read_model_errors(save(tmp_path / "x.mat")) == (0.003, 0.05)
    with pytest.raises(PushLogError, match=r"no avg_diff_angle; it holds .*record_all"):
        read_model_errors(save(tmp_path / "x.mat", avg_diff_angle=None))


@pytest.mark.parametrize(
    ("record", "message"),
    [
        (
            [RECORD, RECORD | {"init_tip_pt": [0.2, np.nan]}],
            "init_tip_pt of push_2 .* expected 2 finite",
        ),
        ([RECORD | {"final_pose_gt": [0.2, 0.1]}], "final_pose_gt of push_1 .* expected 3 finite"),
        ([RECORD | {"final_pose_gt": "somewhere"}], "final_pose_gt of push_1 .* expected 3 finite"),
        (
            [RECORD | {"final_tip_pt": RECORD["init_tip_pt"]}],
            "push_1: the pusher ends where it starts",
        ),
        ([{"init_pose_gt": [0.0, 0.0, 0.0]}], "push_1 of record_all has no final_pose_gt"),
        ([1.0, 2.0], "push_1 of record_all has no init_pose_gt"),
    ],
)
def test_bad_records_are_refused(tmp_path, record, message):
    path = save(tmp_path / "x_rect1.mat", record=record)
    with pytest.raises(PushLogError, match=message) as raised:
        import_mit(path)
    assert str(path) in str(raised.value)


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(PushLogError, match="No such file"):
        import_mit(tmp_path / "none_hex.mat")
    with pytest.raises(PushLogError, match="folder"):
        import_mit(tmp_path)
    for name, content in (("text", b"not a mat file, but text " * 20), ("empty", b"")):
        (tmp_path / f"{name}_hex.mat").write_bytes(content)
        with pytest.raises(PushLogError, match="MATLAB v5"):
            import_mit(tmp_path / f"{name}_hex.mat")
    whole = save(tmp_path / "cut_hex.mat").read_bytes()
    (tmp_path / "cut_hex.mat").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(PushLogError, match="MATLAB v5"):
        import_mit(tmp_path / "cut_hex.mat")
    savemat(tmp_path / "other_hex.mat", {"x": 1.0})
    with pytest.raises(PushLogError, match="no record_all; it holds x"):
        import_mit(tmp_path / "other_hex.mat")


@pytest.mark.parametrize("shape", MIT_SHAPES)
def test_areas_agree_with_the_published_masses(shape):
    outline = Polygon(MIT_SHAPES[shape]())
    assert outline.is_valid
    assert outline.exterior.is_ccw
    assert outline.area * MASS_PER_AREA == pytest.approx(PUBLISHED_MASSES[shape], rel=0.025)


@pytest.mark.parametrize(
    ("name", "start_90", "end_median"),
    [("abs_rect1", 1.3, 0.4), ("abs_hex", 1.1, 0.6), ("plywood_rect3", 2.2, 1.5)],
)
def test_real_pushes_touch_the_object(name, start_90, end_median):
    """The pusher starts at the outline; where it is there still at the end, it does not overlap by much."""
    start, end = gaps(*import_mit(shared_data("mit_pushes", f"{name}.mat")))
    assert start.min() > -0.6
    assert abs(np.median(start)) < 0.6
    assert np.percentile(start, 90) < start_90
    assert start.max() < 6
    assert end.min() > -3
    assert abs(np.median(end)) < end_median
    assert np.mean(np.abs(end) < 3) > 0.7


@pytest.mark.parametrize("name", ["abs_rect1", "abs_hex", "plywood_rect3"])
def test_real_pushes_as_a_whole(name):
    path = shared_data("mit_pushes", f"{name}.mat")
    log, obj = import_mit(path)
    assert obj.name == name.rpartition("_")[2]
    assert len(log) > 350
    length = np.array([seen.push.length for seen in log])
    assert abs(length - 0.05).max() < 2e-4
    motion = np.array([seen.final_pose - seen.pose for seen in log])
    assert np.linalg.norm(motion[:, :2], axis=1).max() < 0.055
    assert np.abs(motion[:, 2]).max() < np.pi / 3
    position, angle = read_model_errors(path)
    assert 0.002 < position < 0.006
    assert 0.03 < angle < 0.1


def test_hexagon_has_a_vertex_on_the_x_axis():
    log, vertex_on_x = import_mit(shared_data("mit_pushes", "abs_hex.mat"))
    turn = np.array(
        [[np.cos(np.pi / 6), np.sin(np.pi / 6)], [-np.sin(np.pi / 6), np.cos(np.pi / 6)]]
    )
    edge_on_x = GridObject.from_outline(MIT_SHAPES["hex"]() @ turn, max_cells=20)
    assert np.abs(gaps(log, vertex_on_x)[0]).mean() < 0.5
    assert np.abs(gaps(log, edge_on_x)[0]).mean() > 2
