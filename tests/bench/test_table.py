import json
from itertools import product
from typing import get_args

import pytest
from rich.console import Console

from gridpush_drake.bench import drake, grasp, paper, planning, real
from gridpush_drake.bench.pregrasp import experiments as pregrasp
from gridpush_drake.bench.pregrasp.exploring import AIM_NAMES, POKE_LENGTHS, ExplorationScore, Trace
from gridpush_drake.bench.pregrasp.world import PreGraspOutcome
from gridpush_drake.bench.timing import measure, one_core
from gridpush_drake.bench.worlds import plant
from gridpush_drake.identification.methods import METHOD_NAMES
from gridpush_drake.objects.object_file import list_shipped_objects
from gridpush_drake.report.table import Mean, Table

TABLE = Table(
    "One push",
    ("what", "ms", "runs"),
    [["plain", 0.41234, 50], ["beside", 1344.8, None]],
    ["On one core."],
)


def test_as_json():
    document = json.loads(json.dumps(TABLE.to_dict()))
    assert document["columns"] == ["what", "ms", "runs"]
    assert document["rows"] == [["plain", 0.41234, 50], ["beside", 1344.8, None]]


def show(table, width):
    """What a terminal as wide as that shows."""
    console = Console(width=width)
    with console.capture() as capture:
        console.print(table)
    return capture.get()


def read_cells(shown):
    """The cells of each line between a table's heads and rules, without the blanks around them."""
    lines = [line for line in shown.splitlines() if line.startswith("│")]
    return [[cell.strip() for cell in line.strip("│").split("│")] for line in lines]


def test_as_text():
    shown = show(TABLE, 80)
    for text in ("One push", "0.412", "1340", "50", "-", "On one core."):
        assert text in shown


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


NAMES = list_shipped_objects()
ERROR = 0.1234567


def make_paper_tables():
    methods = (paper.UNIFORM_PRIOR, *METHOD_NAMES)
    scores = [
        paper.PaperScore(name, number, training, method, 1500, 1500, ERROR * (1 + number))
        for name, number, training, method in product(NAMES, range(2), (1, 5), methods)
    ]
    return [
        paper.tabulate_methods(scores, NAMES, methods, 5, 1500),
        paper.tabulate_training(scores, NAMES, paper.DEFAULT_METHOD, 1500),
        paper.tabulate_budgets(scores, methods, 5),
    ]


def make_planning_tables():
    modes = (planning.LEARNING_MODEL, planning.LOOK_AHEAD)
    decisions = [
        planning.Decision(name, method, 422, ERROR, 1.2345)
        for name, method in product(NAMES, ("gradient", "finite_difference", "exhaustive"))
    ]
    runs = [
        planning.Run(
            name, mode, False, True, 25, "too many pushes", ERROR, ERROR, 1234, 1234.5, 123.4
        )
        for name, mode in product(NAMES, modes)
    ]
    return [
        planning.tabulate_decisions(decisions, NAMES),
        planning.tabulate_runs(runs, NAMES, modes),
    ]


def make_real_tables():
    names, counts = [*real.FEET_SETS, "hardboard_patch"], (5, 25)
    models = ((real.UNIFORM_PRESSURE, 0), *product((real.POSES_MODEL, real.CENTER_MODEL), counts))
    scores = [
        real.RealPushScore(name, split, model, count, (ERROR, ERROR * split), (1.0, 2.0))
        for name, split, (model, count) in product([*names, *NAMES], range(2), models)
    ]
    return [
        real._tabulate_cmu(scores, names, counts),
        real._tabulate_curve(scores, names, counts),
        real._tabulate_simulated(scores, NAMES),
    ]


def make_pregrasp_tables():
    methods = ("learned, wide friction", "unbounded")
    slides = [
        pregrasp.SlideScore(name, method, PreGraspOutcome(True, False, 13, 12, ""))
        for name, method in product(NAMES, methods)
    ]
    trace = Trace(21, ERROR, 1.0)
    pokes = [
        ExplorationScore(name, aim, distance, trace, trace)
        for name, aim, distance in product(NAMES, AIM_NAMES, POKE_LENGTHS)
    ]
    grasps = [
        grasp.GraspEpisode(
            *(name, 0, "dropped", "It fell.", "dropped", 5, 3, 2, 0.1, 0.2, 123.4, 234.5),
            could_be_held=True,
        )
        for name in NAMES
    ]
    return [
        pregrasp.tabulate_slides(slides, methods),
        pregrasp.tabulate_objects(slides, NAMES, methods[0]),
        pregrasp.tabulate_exploration(pokes),
        pregrasp.tabulate_exploration_by_object(pokes, NAMES),
        grasp.tabulate_episodes(grasps, NAMES),
    ]


def make_drake_tables():
    stations = [
        drake.StationScore(
            name, 0, "finished", 8, 4, (ERROR,) * 3, (ERROR,) * 2, ERROR, 0.5, 0, 123.4
        )
        for name in NAMES
    ]
    plants = [
        plant.PlantScore(name, kind, 0, spin, ERROR, ERROR, ERROR, ERROR, ERROR, ERROR, pusher)
        for name, kind, spin, pusher in product(
            NAMES, get_args(plant.PlantKind), plant.SPIN_MODELS, plant.PUSHER_NAMES
        )
    ]
    return [drake.make_table(stations), plant.make_table(plants)]


@pytest.mark.parametrize(
    "make",
    [
        make_paper_tables,
        make_planning_tables,
        make_real_tables,
        make_pregrasp_tables,
        make_drake_tables,
    ],
)
def test_a_terminal_of_80_columns_shows_all_of_every_table(make):
    for table in make():
        check_shown_whole(table)


def check_shown_whole(table):
    """Every value stands whole on a line of its row, at most 80 characters wide, and nothing is left out."""
    shown = show(table, 80)
    assert max(map(len, shown.splitlines())) <= 80
    assert "…" not in shown
    parts = table.split(80)
    assert [i for part in parts for i in part if i >= table.keys] == list(
        range(table.keys, len(table.columns))
    )
    assert read_cells(shown) == [
        [table.format(row[i]) for i in part] for part in parts for row in table.rows
    ]


def test_a_wide_table_is_shown_in_parts_with_its_keys():
    columns = ("object", "model", *(f"figure {i}, mm" for i in range(9)))
    table = Table("Wide", columns, [["hammer", "learned", *[123456.0] * 9]], keys=2)
    assert [part[:2] for part in table.split(60)] == [[0, 1]] * len(table.split(60))
    assert len(table.split(60)) > 1
    assert table.split(200) == [list(range(11))]


def test_a_sentence_wider_than_the_terminal_is_broken_between_words():
    sentence = "learned 100 % (0 % dropped); uniform 92 % (8 % dropped); unbounded 92 % (8 % dropped); true 100 %"
    table = Table(
        "Wide", ("figure", "here"), [["mass_maps", sentence], ["pregrasp", "28 simulations"]]
    )
    shown = show(table, 60)
    assert max(map(len, shown.splitlines())) <= 60
    cells = read_cells(shown)
    assert [key for key, _ in cells if key] == ["mass_maps", "pregrasp"]
    assert " ".join(text for _, text in cells) == f"{sentence} 28 simulations"


def test_brackets_are_no_markup():
    table = Table("[bold]", ("[red]what", "b"), [["[i]", "[b]"]], ["pip install '.[bench]'"])
    shown = show(table, 80)
    for text in ("[bold]", "[red]what", "[i]", "[b]", "pip install '.[bench]'"):
        assert text in shown


@pytest.mark.parametrize(
    ("mean", "text", "figures"),
    [
        (Mean(2.0), "2.00", [2.0, None, None]),
        (Mean(2.0, 1.5, 2.5, even=True), "2.00 ± 0.50", [2.0, 1.5, 2.5]),
        (Mean(2.0, 1.0, 2.25), "2.00 (1.00 to 2.25)", [2.0, 1.0, 2.25]),
    ],
)
def test_a_mean_is_text_to_people_and_numbers_to_machines(mean, text, figures):
    table = Table("means", ["what", "how large"], [["a", mean]])
    assert f"| a | {text} |" in table.to_markdown()
    assert table.to_dict()["rows"][0][1] == dict(zip(("mean", "low", "high"), figures, strict=True))
