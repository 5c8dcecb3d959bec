import json

import pytest
from rich.console import Console

from gridpush_drake.bench.table import Table
from gridpush_drake.bench.timing import measure, one_core

TABLE = Table("One push", ("what", "ms", "runs"), [["plain", 0.41234, 50], ["beside", 1344.8, None]], ["On one core."])


def test_as_json():
    document = json.loads(json.dumps(TABLE.to_dict()))
    assert document["columns"] == ["what", "ms", "runs"]
    assert document["rows"] == [["plain", 0.41234, 50], ["beside", 1344.8, None]]


def test_as_text():
    console = Console(width=80)
    with console.capture() as capture:
        console.print(TABLE.to_rich())
    for text in ("One push", "0.412", "1340", "50", "-", "On one core."):
        assert text in capture.get()


def test_as_markdown():
    assert "| beside | 1340 | - |" in TABLE.to_markdown().splitlines()


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (float("nan"), "-"),
        (1.0, "1.00"),
        (-0.0123456, "-0.0123"),
        (999.9, "1000"),
        (123456.0, "123000"),
        (2.5e7, "2.5e+07"),
    ],
)
def test_shows_three_digits(value, text):
    assert TABLE.format(value) == text


def test_rows_are_as_long_as_the_columns():
    with pytest.raises(ValueError, match="row of 1"):
        Table("One", ("a", "b"), [["only"]])


def test_timing():
    runs = []
    timing = measure(lambda: runs.append(1), repetitions=5, warm_up=2)
    assert len(runs) == 7
    assert timing.low <= timing.median <= timing.high
    with one_core():
        pass
