"""A stream of poses, in its file and cut into pushes."""

import numpy as np
import pytest

from gridpush_drake.errors import PushLogError
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.segmentation import RecordOptions, Sample
from gridpush_drake.pushes.stream import (
    calc_velocities,
    estimate_delay,
    read_stream_csv,
    record_pushes,
    write_stream_csv,
)
from tests.helpers.scripted_stream import PERIOD, RADIUS, Script, poke_four_times
from tests.helpers.shapes import make_shape


@pytest.fixture(scope="module")
def script() -> Script:
    return poke_four_times(Script(make_shape("l_bracket", 20)))


def assert_same(one: PushLog, other: PushLog) -> None:
    assert [seen.name for seen in one] == [seen.name for seen in other]
    for a, b in zip(one, other, strict=True):
        for x, y in (
            (a.push.t, b.push.t),
            (a.push.xy, b.push.xy),
            (a.pose, b.pose),
            (a.t_observed, b.t_observed),
        ):
            np.testing.assert_array_equal(x, y)
        np.testing.assert_array_equal(a.poses_observed, b.poses_observed)


def test_a_stream_survives_its_file_bit_for_bit(script, tmp_path):
    samples = list(script.samples)
    samples[5] = samples[5]._replace(pose=(np.nan,) * 3)
    samples[7] = samples[7]._replace(tip=(np.nan,) * 3)
    write_stream_csv(samples, tmp_path / "stream.csv")
    back = read_stream_csv(tmp_path / "stream.csv")
    assert len(back) == len(samples)
    for one, other in zip(samples, back, strict=True):
        tip = Sample(one.t, one.pose, (np.nan,) * 3, (np.nan,) * 3) if np.isnan(one.tip[0]) else one
        np.testing.assert_array_equal(np.hstack(tip), np.hstack(other))
    assert_same(
        record_pushes(samples, script.obj, RADIUS).log, record_pushes(back, script.obj, RADIUS).log
    )


def test_what_is_left_out(script):
    """The last push counts only once it is over."""
    whole = record_pushes(script.samples, script.obj, RADIUS)
    assert len(whole.log) == 4 and not whole.unfinished and not whole.unusable
    end = next(i for i, seen in enumerate(script.samples) if seen.t > whole.log[0].push.t[-1] + 12)
    moving = next(
        i
        for i in range(end, len(script.samples))
        if script.samples[i].velocity[0] and script.low(i)
    )
    cut = record_pushes(script.samples[: moving + 3], script.obj, RADIUS)
    assert cut.unfinished and 0 < len(cut.log) < 4
    assert_same(cut.log, whole.log[: len(cut.log)])


def test_velocities_need_not_be_in_the_file(script, tmp_path):
    path, obj = tmp_path / "stream.csv", script.obj
    write_stream_csv(script.samples, path)
    rows = [line.split(",") for line in path.read_text().splitlines()]
    path.write_text("\n".join(",".join(row[:4] + row[7:]) for row in rows))
    with_them, without = (
        record_pushes(s, obj, RADIUS).log for s in (script.samples, read_stream_csv(path))
    )
    assert len(without) == len(with_them) == 4
    for one, other in zip(with_them, without, strict=True):
        np.testing.assert_allclose(one.push.xy[[0, -1]], other.push.xy[[0, -1]], atol=1e-9)
        np.testing.assert_allclose(one.final_pose, other.final_pose, atol=5e-4)


def test_velocities_of_an_uneven_noisy_motion():
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.002, 0.02, 400)) + 1.7e9
    places = np.column_stack([0.03 * (t - t[0]), np.full(len(t), 2.0)]) + rng.normal(
        0, 1e-5, (400, 2)
    )
    places[100:110] = np.nan
    velocity = calc_velocities(t, places)
    assert np.isnan(velocity[100:110]).all()
    np.testing.assert_allclose(velocity[5:95], np.tile([0.03, 0.0], (90, 1)), atol=1e-3)
    assert np.isnan(calc_velocities(np.array([0.0, 1.0]), np.array([[0.0], [np.nan]]))).all()


@pytest.mark.parametrize("late", [0, 1, 3])
def test_a_delay_is_found(script, late):
    samples = script.samples
    delayed = [
        now._replace(pose=old.pose)
        for now, old in zip(samples[late:], samples[: len(samples) - late], strict=True)
    ]
    delay = estimate_delay(delayed, script.obj, RADIUS)
    assert delay.pushes == 4 and delay.std < 0.012
    assert abs(delay.value - late * PERIOD) < 3 * delay.std
    known = estimate_delay(
        delayed, script.obj, RADIUS, record=RecordOptions(pose_delay=late * PERIOD)
    )
    assert abs(known.value) < 3 * known.std


def test_no_push_has_no_delay(script):
    assert estimate_delay(script.samples[:10], script.obj, RADIUS) is None


HEADER = "t,tip_x,tip_y,object_x,object_y,object_theta\n"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty"),
        (HEADER, "is empty"),
        ("t,tip_x,tip_y,object_x,object_y\n0,0,0,0,0\n", "object_theta: is missing"),
        (HEADER.replace("tip_y", "tipy") + "0,0,0,0,0,0\n", "tipy: is unknown"),
        (HEADER.replace("t,", "t,t,") + "0,0,0,0,0,0,0\n", "column t: is there twice"),
        ("tip_vx," + HEADER + "0,0,0,0,0,0,0\n", "tip_vy: is missing"),
        (HEADER + "0,0,0,0,0\n", "line 2: has 5 fields"),
        (HEADER + "0,0,0,0,0,0\n0,0,0,0,0,0\n", "line 3, column t: is 0.0 after 0.0"),
        (HEADER + "0,0,,0,0,0\n", "column tip_y: is ''"),
        (HEADER + "0,0,0,0,nan,0\n", "column object_y: is 'nan'"),
        (HEADER + "now,0,0,0,0,0\n", "column t: is 'now'"),
    ],
)
def test_a_file_of_another_form_is_refused(tmp_path, text, says):
    path = tmp_path / "stream.csv"
    path.write_text(text)
    with pytest.raises(PushLogError) as error:
        read_stream_csv(path)
    assert str(path) in str(error.value) and says in str(error.value)
