"""A stream of poses, in its file and cut into pushes."""

import numpy as np
import pytest

from gridpush_drake.errors import PushLogError, PushLogWarning
from gridpush_drake.pushes import segmentation
from gridpush_drake.pushes.pose_delay import choose_delay, estimate_delay
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.segmentation import Sample
from gridpush_drake.pushes.stream import (
    calc_velocities,
    read_stream_csv,
    record_pushes,
    write_stream_csv,
)
from tests.helpers.scene_cases import PLATE
from tests.helpers.scripted_stream import RADIUS, Script, poke_four_times
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
    read = read_stream_csv(tmp_path / "stream.csv")
    assert read.pose_delay is None
    back = read.samples
    assert len(back) == len(samples)
    for one, other in zip(samples, back, strict=True):
        tip = Sample(one.t, one.pose, (np.nan,) * 3, (np.nan,) * 3) if np.isnan(one.tip[0]) else one
        np.testing.assert_array_equal(np.hstack(tip), np.hstack(other))
    assert_same(
        record_pushes(samples, script.obj, RADIUS).log, record_pushes(back, script.obj, RADIUS).log
    )


def test_the_angle_of_a_shape_is_kept_and_its_pushes_have_it(script, tmp_path):
    turned = [seen._replace(yaw=0.1 + 0.01 * seen.t) for seen in script.samples]
    write_stream_csv(turned, tmp_path / "stream.csv", pose_delay=0.0)
    read = read_stream_csv(tmp_path / "stream.csv").samples
    assert [seen.yaw for seen in read] == [seen.yaw for seen in turned]
    recording = record_pushes(read, script.obj, PLATE)
    assert len(recording.log) >= 3
    for begin, seen in zip(recording.begins, recording.log, strict=True):
        assert seen.push.shape is PLATE
        np.testing.assert_allclose(seen.push.yaw, 0.1 + 0.01 * (begin + seen.push.t), atol=1e-9)


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
        record_pushes(s, obj, RADIUS).log for s in (script.samples, read_stream_csv(path).samples)
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


def make_late(script: Script, delay: float, every: int = 1, seed: int = 0) -> list[Sample]:
    """What a tracker says whose poses are late by any time, s; and of it each `every`-th sample."""
    t = np.array([sample.t for sample in script.samples])
    truth = np.array(script.truth)
    seen = np.column_stack([np.interp(t - delay, t, truth[:, axis]) for axis in range(3)])
    seen += script.noise * np.random.default_rng(seed).normal(size=truth.shape)
    late = [
        sample._replace(pose=tuple(pose))
        for sample, pose in zip(script.samples, seen.tolist(), strict=True)
    ]
    return late[::every]


@pytest.mark.parametrize("every", [1, 3])
@pytest.mark.parametrize("delay", [0.0, 0.15])
def test_a_delay_is_found(script, delay, every):
    errors, stds = [], []
    for seed in range(4):
        found = estimate_delay(make_late(script, delay, every, seed), script.obj)
        assert found.pushes >= 2
        errors.append(found.value - delay)
        stds.append(found.std)
    errors, stds = np.array(errors), np.array(stds)
    assert (np.abs(errors) < 3.5 * stds).all()
    assert abs(errors.mean()) < 0.012
    assert stds.mean() < (0.012 if every == 1 else 0.025)


def test_who_is_told_what_was_found_finds_it_again(script):
    samples = make_late(script, 0.147)
    found = choose_delay(samples, script.obj)
    assert found.found is not None and found.value == found.found.value
    again = choose_delay(samples, script.obj, given=found.value, given_by="--pose-delay")
    assert again.found == found.found and not again.is_contradicted
    assert "and they are" in again.describe()
    wrong = choose_delay(samples, script.obj, given=0.0, given_by="--pose-delay")
    assert wrong.value == 0.0 and wrong.is_contradicted and "but they are" in wrong.describe()


def test_no_push_has_no_delay(script):
    assert estimate_delay(script.samples[:10], script.obj) is None
    chosen = choose_delay(script.samples[:10], script.obj)
    assert chosen.value == 0 and "the pushes do not tell it" in chosen.describe()


def test_a_file_says_its_delay(script, tmp_path):
    path = tmp_path / "stream.csv"
    write_stream_csv(script.samples, path, pose_delay=0.1)
    lines = path.read_text().splitlines()
    assert lines[0].endswith(",object_delay")
    assert lines[1].endswith(",0.1") and lines[2].endswith(",")
    read = read_stream_csv(path)
    assert read.pose_delay == 0.1 and len(read.samples) == len(script.samples)


def test_further_columns_and_nan_are_passed_over(tmp_path):
    path = tmp_path / "stream.csv"
    path.write_text(
        "frame,t,tip_x,tip_y,object_x,object_y,object_theta,object_delay\n"
        "1,0,0,0,NaN,nan,,0.1\n2,1,,nan,0.1,0.2,0.3,nan\n"
    )
    with pytest.warns(PushLogWarning, match=r"stream\.csv: passed over the column frame; known"):
        read = read_stream_csv(path)
    assert read.pose_delay == 0.1
    assert np.isnan(read.samples[0].pose).all() and np.isnan(read.samples[1].tip).all()
    assert read.samples[1].pose == (0.1, 0.2, 0.3)


def test_a_motion_without_an_end_is_refused(script, monkeypatch):
    monkeypatch.setattr(segmentation, "MAX_SAMPLES", 50)
    with pytest.raises(PushLogError, match=r"begins at t = .* s has more than 50 samples"):
        record_pushes(script.samples, script.obj, RADIUS)


HEADER = "t,tip_x,tip_y,object_x,object_y,object_theta\n"
DELAYED = HEADER[:-1] + ",object_delay\n"


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
        (HEADER[:-1] + ",object_delays\n0,0,0,0,0,0,1\n", "did you mean 'object_delay'?"),
        (DELAYED + "0,0,0,0,0,0,100\n", "column object_delay: is 100; expected how late"),
        (DELAYED + "0,0,0,0,0,0,soon\n", "column object_delay: is 'soon'; expected how late"),
        (DELAYED + "0,0,0,0,0,0,0.1\n1,0,0,0,0,0,0.2\n", "is 0.2 after 0.1; expected one delay"),
    ],
)
def test_a_file_of_another_form_is_refused(tmp_path, text, says):
    path = tmp_path / "stream.csv"
    path.write_text(text)
    with pytest.raises(PushLogError) as error:
        read_stream_csv(path)
    assert str(path) in str(error.value) and says in str(error.value)
