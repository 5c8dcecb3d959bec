import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import DEFAULT_PUSHER_RADIUS, PusherShape
from gridpush_drake.errors import OutputError, PushError, PushLogError, PushLogWarning
from gridpush_drake.pushes import push_csv
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

HEADER = "push,t,tip_x,tip_y,object_x,object_y,object_theta"
GOOD = f"""{HEADER}
a,0,-0.1,0,0,0,0
a,1,-0.05,0,,,
a,2,0,0,0.02,0,0.1
b,5,0,0.1,0.5,0.5,3
b,6,0,0.2,0.5,0.6,-3
"""
FORCED = f"""{HEADER},force_x,force_y
a,0,-0.1,0,0,0,0,,
a,1,-0.05,0,,,,1.5,-2
a,2,0,0,0.02,0,0.1,3,4
"""


@pytest.fixture
def write(tmp_path):
    def write(content):
        path = tmp_path / "log.csv"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


def refused(path, *messages, **options):
    with pytest.raises(PushLogError) as raised:
        PushLog.read_csv(path, **options)
    for message in (str(path), *messages):
        assert message in str(raised.value)


def test_reads_what_is_there(write):
    path = write(GOOD)
    log = PushLog.read_csv(path)
    assert log.source == str(path)
    first, second = log
    assert (first.name, second.name) == ("a", "b")
    np.testing.assert_array_equal(first.push.t, [0, 1, 2])
    np.testing.assert_array_equal(first.push.xy, [[-0.1, 0], [-0.05, 0], [0, 0]])
    np.testing.assert_array_equal(first.pose, [0, 0, 0])
    np.testing.assert_array_equal(first.t_observed, [2])
    np.testing.assert_array_equal(first.poses_observed, [[0.02, 0, 0.1]])
    assert first.force is None
    assert first.force_t is None
    assert second.push.duration == 1


def test_angles_are_continuous(write):
    second = PushLog.read_csv(write(GOOD))[1]
    assert second.pose[2] == 3
    assert second.final_pose[2] == pytest.approx(math.tau - 3)


def test_angles_are_continuous_from_observation_to_observation(write):
    turning = "".join(f"a,{i},0,0,0,0,{math.remainder(2.5 * i, math.tau)!r}\n" for i in range(9))
    poses = PushLog.read_csv(write(f"{HEADER}\n{turning}"))[0].poses_observed
    np.testing.assert_allclose(poses[:, 2], 2.5 * np.arange(1, 9))


def test_force_is_read_where_it_was_measured(write):
    seen = PushLog.read_csv(write(FORCED))[0]
    np.testing.assert_array_equal(seen.force_t, [1, 2])
    np.testing.assert_array_equal(seen.force, [[1.5, -2], [3, 4]])
    assert seen.lift_force is None


def add_column(text: str, cells: list[str]) -> str:
    return "\n".join(f"{row},{cell}" for row, cell in zip(text.splitlines(), cells, strict=True))


def test_an_upward_force_is_read_with_the_other_two(write):
    seen = PushLog.read_csv(write(add_column(FORCED, ["force_z", "", "0.5", "-1"])))[0]
    np.testing.assert_array_equal(seen.force, [[1.5, -2], [3, 4]])
    np.testing.assert_array_equal(seen.lift_force, [0.5, -1])


@pytest.mark.parametrize(
    ("cells", "line", "says"),
    [
        (["force_z", "1", "0.5", "-1"], 2, "is 1, but force_x and force_y are empty"),
        (["force_z", "", "0.5", ""], 4, "is empty; expected a number .* or in none"),
        (
            ["force_z", "", "0.5", "up"],
            4,
            r"is 'up'; expected a finite number \(N\), or force_z empty",
        ),
    ],
)
def test_an_upward_force_without_the_others_is_refused(write, cells, line, says):
    with pytest.raises(PushLogError, match=rf"line {line}, column force_z: {says}"):
        PushLog.read_csv(write(add_column(FORCED, cells)))


def test_an_upward_force_alone_is_passed_over(write):
    text = add_column(GOOD, ["force_z"] + ["1"] * (len(GOOD.splitlines()) - 1))
    with pytest.warns(PushLogWarning, match="passed over the column force_z"):
        log = PushLog.read_csv(write(text))
    assert log[0].force is None and log[0].lift_force is None


def test_a_push_over_the_edge_is_marked_by_any_of_its_rows(write):
    column = ["overhang", "0", "", "1", "0", " "]
    log = PushLog.read_csv(
        write("\n".join(map(",".join, zip(GOOD.splitlines(), column, strict=True))))
    )
    assert [seen.overhang for seen in log] == [True, False]
    assert [seen.name for seen in log.supported] == ["b"]
    assert [seen.name for seen in log.overhanging] == ["a"]
    with pytest.raises(PushLogError, match=r"log\.csv: overhang is 1 in every push; expected"):
        _ = log[:1].supported


def test_without_the_column_nothing_hangs_over(write):
    log = PushLog.read_csv(write(GOOD))
    assert not any(seen.overhang for seen in log)
    log.write_csv(log.source + ".again")
    assert Path(log.source + ".again").read_text().startswith(HEADER + "\n")


def test_radius_given_or_not(write):
    path = write(GOOD)
    assert not PushLog.read_csv(path).radius_given
    assert PushLog.read_csv(path)[0].push.radius == DEFAULT_PUSHER_RADIUS
    given = PushLog.read_csv(path, radius=0.01)
    assert given.radius_given
    assert [seen.push.radius for seen in given] == [0.01, 0.01]
    for radius in (0.0, -1.0, math.nan):
        with pytest.raises(PushError, match="radius"):
            PushLog.read_csv(path, radius=radius)


def test_columns_in_any_order(write):
    rows = [line.split(",") for line in FORCED.splitlines()]
    turned = "\n".join(",".join(reversed(row)) for row in rows)
    seen = PushLog.read_csv(write(turned))[0]
    np.testing.assert_array_equal(seen.final_pose, [0.02, 0, 0.1])
    np.testing.assert_array_equal(seen.force[-1], [3, 4])


@pytest.mark.parametrize(
    "content",
    [
        b"\xef\xbb\xbf" + GOOD.encode(),
        GOOD.replace("\n", "\r\n"),
        GOOD + "\n\n  \n,,,,,,\n",
        GOOD.rstrip("\n"),
        GOOD.replace(",", " , "),
        GOOD.replace("a,", '"a",'),
    ],
    ids=["bom", "crlf", "blank end", "no newline at end", "blanks", "quotes"],
)
def test_same_log_in_other_clothes(write, content):
    log = PushLog.read_csv(write(content))
    assert [seen.name for seen in log] == ["a", "b"]
    np.testing.assert_array_equal(log[0].final_pose, [0.02, 0, 0.1])


def test_further_columns_are_passed_over_with_a_warning(write):
    rows = GOOD.splitlines()
    more = [f"label,{rows[0]},force_z,,table_id,c1,c2,c3"]
    more += [f"x,{row},1,2,3,4,5,6" for row in rows[1:]]
    with pytest.warns(
        PushLogWarning,
        match=r"passed over the columns label, force_z, \(without a name\), table_id, c1 and 2 more",
    ):
        log = PushLog.read_csv(write("\n".join(more)))
    assert [seen.name for seen in log] == ["a", "b"] and log[0].force is None


def test_nan_counts_as_empty(write):
    """As pandas writes a log: nan where a column of numbers has nothing, and flags with a point."""
    header = f"{HEADER},force_x,force_y,overhang,table"
    rows = [
        "a,0,-0.1,0,0,0,0,nan,nan,0.0,nan",
        "a,1,-0.05,0,nan,NaN,,1.5,-2,NaN,",
        "a,2,0,0,0.02,0,0.1,NAN,nan,1.0,nan",
    ]
    (seen,) = PushLog.read_csv(write("\n".join([header, *rows])))
    np.testing.assert_array_equal(seen.poses_observed, [[0.02, 0, 0.1]])
    np.testing.assert_array_equal(seen.force, [[1.5, -2]])
    assert seen.overhang


def test_an_endless_push_is_refused_early(write, monkeypatch):
    parsed = []
    parse = push_csv._parse_row
    monkeypatch.setattr(push_csv, "_parse_row", lambda *row: parsed.append(row) or parse(*row))
    monkeypatch.setattr(push_csv, "MAX_ROWS", 100)
    rows = "".join(f"a,{i},0,0,0,0,0\n" for i in range(10_000))
    refused(write(f"{HEADER}\n{rows}"), "line 102", "'a' has more than 100 rows", "gridpush record")
    assert len(parsed) == 101


def test_of_very_many_poses_evenly_spread_ones_are_kept(write):
    count = 20 * push_csv.MAX_POSES
    rows = "".join(f"a,{i},{i}e-5,0,{i}e-6,0,0\n" for i in range(count))
    with pytest.warns(PushLogWarning, match=r"push 'a' has 5999 poses after its first row; 300 of"):
        (seen,) = PushLog.read_csv(write(f"{HEADER}\n{rows}"))
    assert len(seen.t_observed) == push_csv.MAX_POSES
    assert seen.t_observed[-1] == count - 1 and seen.push.t[-1] == count - 1
    assert len(seen.push.t) == count
    assert np.diff(seen.t_observed).min() >= 19 and np.diff(seen.t_observed).max() <= 21


def test_without_final_pose_only_when_asked(write):
    path = write(f"{HEADER}\na,0,0,0,0,0,0\na,1,1,0,,,\n")
    refused(path, "line 3", "object_x", "later row", "'a'")
    seen = PushLog.read_csv(path, require_final=False)[0]
    assert seen.t_observed.shape == (0,)
    assert seen.poses_observed.shape == (0, 3)


def replaced(old, new):
    assert old in GOOD
    return GOOD.replace(old, new, 1)


@pytest.mark.parametrize(
    ("content", "messages"),
    [
        ("", ["is empty", HEADER]),
        ("\n\n", ["is empty"]),
        (HEADER + "\n", ["holds no push"]),
        (GOOD.replace(",", ";"), ["line 1", "separated by semicolons; expected commas"]),
        (GOOD.replace(",", "\t"), ["line 1", "separated by tabs; expected commas"]),
        (b"\x89PNG\r\n\x00\x01", ["not UTF-8 text"]),
        (b"\xff\xfe\xfa", ["not UTF-8 text"]),
        (
            replaced("tip_x", "tipx"),
            ["line 1", "column tip_x", "missing", "rename 'tipx' to 'tip_x'"],
        ),
        (replaced(",tip_y", ""), ["line 1", "column tip_y", "missing"]),
        (replaced("object_theta", "theta"), ["column object_theta", "rename 'theta'"]),
        (replaced("push,", "Push,"), ["column push", "rename 'Push'"]),
        (replaced("tip_y", "tip_x"), ["column tip_x", "twice"]),
        (
            FORCED.replace("force_y", "forcey"),
            ["column forcey", "unknown", "did you mean 'force_y'"],
        ),
        (FORCED.replace("force_y", "zebra"), ["column force_y", "is missing", "together"]),
        (
            "\n".join(line.rpartition(",")[0] for line in FORCED.splitlines()),
            ["column force_y", "missing", "together"],
        ),
        (replaced("-0.05", "west"), ["line 3", "column tip_x", "'west'", "finite number (m)"]),
        (replaced("-0.05", ""), ["line 3", "column tip_x", "''"]),
        (replaced("-0.05", "nan"), ["line 3", "column tip_x", "'nan'"]),
        (replaced("a,1,", "a,inf,"), ["line 3", "column t", "'inf'", "(s)"]),
        (replaced("-0.05", "1_0"), ["line 3", "column tip_x"]),
        (replaced("0.1\n", "1e999\n"), ["line 4", "column object_theta", "(rad)"]),
        (replaced("0.02,0,0.1", "0.02,,0.1"), ["line 4", "column object_y", "empty"]),
        (replaced("0.02,0,0.1", "0.02,0,"), ["line 4", "column object_theta"]),
        (FORCED.replace("1.5,-2", "1.5,"), ["line 3", "column force_y", "(N)"]),
        (replaced("a,0,-0.1,0,0,0,0", "a,0,-0.1,0,,,"), ["line 2", "object_x", "first row"]),
        (replaced("a,2,0,0,0.02,0,0.1", "a,2,0,0,,,"), ["line 4", "later row"]),
        (replaced("a,1", "a,0"), ["line 3", "column t", "increase"]),
        (replaced("a,2", "a,0.5"), ["line 4", "column t", "increase"]),
        (replaced("b,6", "c,6"), ["line 5", "'b'", "at least two"]),
        (GOOD + "a,7,0,0,0,0,0\n", ["line 7", "column push", "'a'", "line 2", "together"]),
        (replaced("b,5", ",5"), ["line 5", "column push", "empty"]),
        (replaced("a,1,-0.05,0,,,", "a,1,-0.05,0,,"), ["line 3", "6 fields", "7"]),
        (replaced("a,1,-0.05", "a,1,-0,05"), ["line 3", "8 fields", "7"]),
        (
            GOOD.replace("theta\n", "theta,overhang\n").replace("0.1\n", "0.1,yes\n"),
            ["line 2", "7 fields", "8"],
        ),
        (
            GOOD.replace("\n", ",\n")
            .replace("theta,", "theta,overhang")
            .replace("0,0.1,", "0,0.1,yes"),
            ["line 4", "column overhang", "'yes'", "0 or 1"],
        ),
        (
            replaced("object_theta", "object_theta,overhangs"),
            ["overhangs", "did you mean 'overhang'"],
        ),
        (replaced("a,1", '"a' + "x" * 140_000 + '",1'), ["line 3", "is not CSV"]),
    ],
)
def test_bad_files_are_named_with_line_column_and_form(write, content, messages):
    refused(write(content), *messages)


def test_missing_file_and_folder(tmp_path):
    refused(tmp_path / "none.csv", "No such file")
    refused(tmp_path, "folder")


def make_log(pushes, samples, force=True):
    rng = np.random.default_rng(3)
    seen = []
    for i in range(pushes):
        t = np.append(0.0, np.cumsum(rng.uniform(0.01, 0.03, samples - 1)))
        push = Push.along(t, rng.normal(size=(samples, 2)), 0.004)
        at = push.t[[samples // 2, -1]]
        seen.append(
            ObservedPush(
                f"push, {i}", push, rng.uniform(-1, 1, 3), at, rng.uniform(-1, 1, (2, 3)),
                push.t[1:] if force else None, rng.normal(size=(samples - 1, 2)) if force else None,
                overhang=i % 2 == 1,
                lift_force=rng.normal(size=samples - 1) if force and i != 2 else None,
            )
        )  # fmt: skip
    return PushLog(tuple(seen), radius_given=True)


@pytest.mark.parametrize("force", [True, False])
def test_round_trip_bit_for_bit(tmp_path, force):
    log = make_log(4, 30, force)
    log.write_csv(tmp_path / "log.csv")
    back = PushLog.read_csv(tmp_path / "log.csv", 0.004)
    for seen, again in zip(log, back, strict=True):
        assert seen.name == again.name
        for name in (
            "pose",
            "t_observed",
            "poses_observed",
            *(("force_t", "force") if force else ()),
        ):
            np.testing.assert_array_equal(getattr(seen, name), getattr(again, name))
        np.testing.assert_array_equal(seen.push.t, again.push.t)
        np.testing.assert_array_equal(seen.push.xy, again.push.xy)
        if not force:
            assert again.force is None
        if seen.lift_force is None:
            assert again.lift_force is None
        else:
            np.testing.assert_array_equal(seen.lift_force, again.lift_force)
    assert (
        [seen.overhang for seen in back]
        == [seen.overhang for seen in log]
        == [False, True, False, True]
    )
    back.write_csv(tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "log.csv").read_bytes()


def test_times_between_the_tip_samples_get_rows_of_their_own(tmp_path):
    push = Push([0.0, 0.0], [0.01, 0.0], 2.0, 0.004)
    seen = ObservedPush("a", push, [0, 0, 0], [0.5, 2.0], np.zeros((2, 3)), [1.5], [[1.0, 2.0]])
    PushLog((seen,)).write_csv(tmp_path / "log.csv")
    back = PushLog.read_csv(tmp_path / "log.csv")[0]
    np.testing.assert_array_equal(back.push.t, [0, 0.5, 1.5, 2])
    np.testing.assert_allclose(back.push.xy[:, 0], [0, 0.005, 0.015, 0.02])
    np.testing.assert_array_equal(back.t_observed, [0.5, 2.0])
    np.testing.assert_array_equal(back.force_t, [1.5])


def test_a_push_to_be_predicted_round_trips(tmp_path):
    seen = ObservedPush("a", Push([0, 0], [0.01, 0], 2.0, 0.004), [0, 0, 1], [], [])
    PushLog((seen,)).write_csv(tmp_path / "log.csv")
    back = PushLog.read_csv(tmp_path / "log.csv", require_final=False)[0]
    np.testing.assert_array_equal(back.pose, [0, 0, 1])


def test_what_cannot_be_written_is_refused(tmp_path):
    log = make_log(2, 3)
    with pytest.raises(PushLogError, match="two pushes"):
        log[[0, 0]].write_csv(tmp_path / "twice.csv")
    with pytest.raises(PushLogError, match="holds no push"):
        log[:0].write_csv(tmp_path / "none.csv")
    path = tmp_path / "log.csv"
    log.write_csv(path)
    with pytest.raises(OutputError, match="exists already"):
        log.write_csv(path)
    log[:1].write_csv(path, force=True)
    assert len(PushLog.read_csv(path)) == 1
    assert not (tmp_path / "twice.csv").exists()


def test_fifty_pushes_of_a_thousand_rows_are_read(tmp_path):
    make_log(50, 1000).write_csv(tmp_path / "log.csv")
    log = PushLog.read_csv(tmp_path / "log.csv")
    assert len(log) == 50


TABLE = "POLYGON ((-1 -0.5, 1 -0.5, 1 0.5, -1 0.5, -1 -0.5))"


def test_carries_the_table(write, tmp_path):
    rows = [
        f"{HEADER},overhang,table",
        f'a,0,-0.1,0,0,0,0,1,"{TABLE}"',
        "a,1,0,0,0.02,0,0.1,,",
        "b,5,0,0.1,0.5,0.5,3,,",
        "b,6,0,0.2,0.5,0.6,-3,0,",
    ]
    log = PushLog.read_csv(write("\n".join(rows)))
    np.testing.assert_array_equal(log.table, [[-1, -0.5], [1, -0.5], [1, 0.5], [-1, 0.5]])
    assert [seen.overhang for seen in log] == [True, False]
    assert len(log.supported) == 2 and len(log[[0]].supported) == 1
    odd = PushLog(log.pushes, table=log.table / 3)
    odd.write_csv(tmp_path / "again.csv")
    np.testing.assert_array_equal(PushLog.read_csv(tmp_path / "again.csv").table, odd.table)


@pytest.mark.parametrize(
    "text, says",
    [
        ("POLYGON ((0 0, 1 0, 0 1, 1 1, 0 0))", "does not cross itself"),
        ("POLYGON ((0 0, 4 0, 4 4, 0 4, 0 0), (1 1, 2 1, 2 2, 1 2, 1 1))", "no hole"),
        ("POINT (1 2)", "expected POLYGON"),
        ("POLYGON ((0 0, nan 1, 1 1, 0 0))", "expected POLYGON"),
        ("POLYGON ((0 0, inf 1, 1 1, 0 0))", "expected POLYGON"),
        ("a table", "expected POLYGON"),
    ],
)
def test_refuses_what_is_no_table(write, text, says):
    rows = [f"{HEADER},table", f'a,0,-0.1,0,0,0,0,"{text}"', "a,1,0,0,0.01,0,0,"]
    refused(write("\n".join(rows)), "line 2, column table", says)


def test_refuses_two_tables(write):
    other = TABLE.replace("-1 -0.5", "-2 -0.5")
    rows = [f"{HEADER},table", f'a,0,-0.1,0,0,0,0,"{TABLE}"', f'a,1,0,0,0.01,0,0,"{other}"']
    refused(write("\n".join(rows)), "line 3, column table", "another one than before")


SHAPED = f"""{HEADER},tip_yaw,pusher
a,0,-0.1,0,0,0,0,3.1,"MULTIPOINT ((0 -0.02), (0 0.02)) RADIUS 0.003"
a,1,-0.05,0,,,,-3.1,
a,2,0,0,0.02,0,0.1,-3,
b,5,0,0.1,0.5,0.5,3,,
b,6,0,0.2,0.5,0.6,-3,,
"""


def test_carries_the_shape_of_a_pusher_beside_discs(write, tmp_path):
    log = PushLog.read_csv(write(SHAPED), 0.01)
    shaped, plain = (seen.push for seen in log)
    np.testing.assert_array_equal(shaped.shape.core, [[0, -0.02], [0, 0.02]])
    assert (shaped.radius, shaped.shape.joined) == (0.003, False)
    # the angle goes on over a whole turn
    np.testing.assert_allclose(shaped.yaw, [3.1, 2 * np.pi - 3.1, 2 * np.pi - 3])
    assert plain.shape is None
    assert plain.radius == 0.01
    assert log.with_radius(0.02)[0].push.radius == 0.003
    plate = PusherShape.plate(0.05, 0.01, 0.001)
    line = PusherShape([(0, 0), (0, 1 / 3)], 0.01, True)
    for shape in (plate, line):
        push = Push.along([0, 1, 2], shaped.xy, shape=shape, yaw=[0, 1 / 3, 7])
        log = PushLog((replace(log[0], push=push),))
        log.write_csv(tmp_path / "again.csv", force=True)
        again = PushLog.read_csv(tmp_path / "again.csv")[0].push
        np.testing.assert_array_equal(again.shape.core, shape.core)
        assert (again.shape.radius, again.shape.joined) == (shape.radius, True)
        np.testing.assert_allclose(np.exp(1j * again.yaw), np.exp(1j * push.yaw))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("RADIUS 0.003", "", "line 2, column pusher"),
        ("RADIUS 0.003", "RADIUS -1", "line 2, column pusher"),
        ("MULTIPOINT", "MULTI", "line 2, column pusher"),
        ("MULTIPOINT ((0 -0.02), (0 0.02))", "LINESTRING (0 0, 0 0)", "both corners are the same"),
        (",-3.1,", ",,", "line 3, column tip_yaw"),
        ("-3,,\n", "-3,1,\n", "line 6, column tip_yaw"),
    ],
)
def test_refuses_what_is_no_shape_of_a_pusher(write, old, new, says):
    assert old in SHAPED
    refused(write(SHAPED.replace(old, new)), says)
