"""What `repr` says of the package's records, and what a notebook shows of them."""

import subprocess
import sys
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from shapely import Polygon

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import predict
from gridpush_drake.identification.spread import predict_spread
from gridpush_drake.notebook import choose_colors, describe_range, draw_cells, make_table
from gridpush_drake.objects.cells import Cells
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.trial import PlannedPush
from gridpush_drake.planning.goal.push_plan import PushPlan, PushPlanStatus
from gridpush_drake.planning.pregrasp.pregrasp_plan import PreGraspPlan, PreGraspPlanStatus
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.station.tasks.pregrasp_task import PreGraspRecord
from gridpush_drake.station.tasks.task import TaskStatus
from gridpush_drake.systems.base.messages import PreGraspStatus
from tests.helpers.made_identifications import make_block, make_identification
from tests.helpers.made_logs import make_pushed_block

SVG = "{http://www.w3.org/2000/svg}"
MAX_LINES = 2


@pytest.fixture(scope="module")
def records():
    """One of each kind, and what its `repr` must say: name, count, units."""
    obj = replace(make_block(), height=0.03)
    params = CellParameters(np.linspace(0.01, 0.03, obj.n), np.full(obj.n, 0.4), 0.35)
    push = Push((-0.08, 0.01), (0.05, 0.0), 1.0, 0.004)
    motion = simulate(Model(obj, params), push, regime="quasi_static", gradients=True)
    pushed = make_pushed_block()
    log, found = pushed.log, make_identification()
    poses = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.5]])
    planned = PlannedPush(0.1, 0.0, 0.05, push, poses[1], 0.004, 9)
    reached = PushPlanStatus.REACHED
    plan = PushPlan(
        start=poses[0],
        goal=poses[1],
        pushes=(planned,),
        status=reached,
        reason="The object is at the goal.",
        error=0.004,
        errors=np.array([0.004]),
        simulations=9,
        seconds=0.1,
    )
    ready = PreGraspPlanStatus.READY
    slide = PreGraspPlan(ready, "a part hangs over", (push,), poses, None, None)
    table = SupportSurface.rectangle((0.0, 0.0), (0.8, 0.6))
    record = PreGraspRecord(obj, None, table, PreGraspStatus(), log=log, estimates=[found])
    record.status, record.duration = TaskStatus.HELD, 41.9
    (spread, *_), (prediction, *_) = (
        predict_spread(found, log),
        predict(Model(pushed.obj, params_of(pushed)), log),
    )
    return {
        "object": (obj, ["'block'", "18 cells of 20.0 mm", "2 parts", "120 x 60 mm", "30 mm high"]),
        "grid": (obj.grid, ["18 cells of 20.0 mm"]),
        "cells": (Cells(np.zeros((3, 2)), 0.02), ["3 squares", "0.02"]),
        "parameters": (params, ["18 cells", "0.36 kg in all", "0.01 to 0.03 kg", "0.4", "0.35"]),
        "motion": (motion, ["ok", "1 s in", "steps", "mm", "°"]),
        "jacobian": (motion.jacobian, ["18 cells"]),
        "log": (log, [f"PushLog of {len(log)} pushes", "poses", "m of pushing"]),
        "seen": (log[0], [repr(log[0].name), "mm in", "poses", "moved", "°"]),
        "identification": (found, ["'block'", "18 cells", "learned from 4 pushes", "mm"]),
        "posterior": (found.posterior, ["18 cells", "standard deviation"]),
        "identifiability": (found.identifiability, ["of 18 combinations", "mm"]),
        "prediction": (prediction, [repr(prediction.name), "ends at", "m", "°"]),
        "spread": (spread, ["±", "mm", "°", "probability 0.9"]),
        "planned": (planned, ["50 mm", "4.0 mm from the goal"]),
        "plan": (plan, ["reached", "1 push,", "4.0 mm from the goal"]),
        "slide": (slide, ["ready", "1 push", "a part hangs over"]),
        "table": (table, ["4 corners", "0.8 x 0.6 m"]),
        "record": (record, ["PreGraspRecord", "'block'", "held", "42 s simulated"]),
    }  # fmt: skip


def params_of(pushed):
    return CellParameters.uniform(pushed.obj)


def test_every_record_says_what_a_user_wants_to_know_in_a_line_or_two(records):
    for name, (record, words) in records.items():
        said = repr(record)
        assert len(said.splitlines()) <= MAX_LINES and len(said) < 300, (name, said)
        assert "array(" not in said, (name, said)
        for word in words:
            assert word in said, (name, word, said)


def test_a_notebook_shows_well_formed_drawings_and_tables(records):
    drawn = {"object", "grid", "motion", "identification", "prediction", "plan", "slide", "record"}
    tables = {"parameters", "log", "identification", "identifiability", "plan", "slide", "record"}
    shown = {name for name, (record, _) in records.items() if hasattr(record, "_repr_html_")}
    assert shown == drawn | tables
    for name in shown:
        page = ElementTree.fromstring(records[name][0]._repr_html_().replace("<br>", "<br/>"))
        assert (page.find(f".//{SVG}svg") is not None) == (name in drawn), name
        assert (page.find(".//table") is not None) == (name in tables), name


def test_an_identification_is_drawn_with_its_masses(records):
    found, _ = records["identification"]
    page = ElementTree.fromstring(found._repr_html_().replace("<br>", "<br/>"))
    cells = page.findall(f".//{SVG}rect")
    colors = [f"rgb({r},{g},{b})" for r, g, b in choose_colors(found.params.mass)]
    assert [cell.get("fill") for cell in cells] == colors
    # x to the right, y up: the cell farthest right and up lies so in the drawing
    best = int(np.argmax(found.obj.p_BC @ [1.0, 1.0]))
    x, y = (np.array([float(cell.get(at)) for cell in cells]) for at in ("x", "y"))
    assert x[best] == x.max() and y[best] == y.min()
    assert f"dark {found.params.mass.min():.3g}" in ElementTree.tostring(page, "unicode")


def test_a_log_has_a_row_a_push(records):
    log, _ = records["log"]
    page = ElementTree.fromstring(log._repr_html_())
    rows = page.findall(".//tbody/tr")
    assert [row[0].text for row in rows] == [seen.name for seen in log]


def test_names_are_escaped(records):
    obj, _ = records["object"]
    shown = replace(obj, name="<b>&")._repr_html_()
    assert "<b>&" not in shown and "&lt;b&gt;&amp;" in shown
    assert "<td>&lt;i&gt;</td>" in make_table(["a"], [["<i>"]])


def test_holes_are_drawn_and_equal_values_have_one_color():
    ring = Polygon([(0, 0), (3, 0), (3, 3), (0, 3)], [[(1, 1), (2, 1), (2, 2), (1, 2)]])
    centers = np.array([[0.5, 0.5], [2.5, 2.5]])
    drawing = draw_cells(ring, centers, 1.0, np.array([0.2, 0.2]), "kg")
    assert drawing.count("M") == 2  # the outline and its hole
    assert len(set(choose_colors(np.full(4, 0.2)))) == 1
    assert choose_colors(np.array([0.0, 1.0])) == [(68, 1, 84), (253, 231, 37)]
    assert (describe_range([0.2, 0.2], "kg"), describe_range([1, 2])) == ("0.2 kg", "1 to 2")


def test_saying_and_showing_imports_no_plotting():
    code = (
        "import sys; from gridpush_drake import CellParameters, GridObject, list_shipped_objects;"
        "from gridpush_drake.objects.object_file import find_shipped_object;"
        "obj = GridObject.from_yaml(find_shipped_object('pliers')); obj._repr_html_();"
        "CellParameters.uniform(obj)._repr_html_(); print('matplotlib' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.split() == ["False"]
