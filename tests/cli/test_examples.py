"""The plain programs in `docs/examples` run and say what their pages promise; those with JAX in `tests/interop`."""

import ast
import re
import runpy
from pathlib import Path

import numpy as np
import pytest

from gridpush_drake.station.links.ros2 import ros2_pictures, ros2_topics

EXAMPLES = Path(__file__).parents[2] / "docs/examples"

pytestmark = pytest.mark.skipif(
    not EXAMPLES.is_dir(), reason="a wheel's tests have no docs beside them"
)


def run(name, capsys, tmp_path, monkeypatch):
    """What a program prints, and the numbers in it."""
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(EXAMPLES / f"{name}.py"))
    out = capsys.readouterr().out
    return out, [float(number) for number in re.findall(r"-?\d+\.\d+", out)]


def check_push(out, numbers):
    _, y, turn, force, _ = numbers
    assert abs(y) > 10 and abs(turn) > 1 and 0.1 < force < 50


def check_learning(out, numbers):
    predicted, off = numbers
    assert predicted < 4.0 and off < 3.0


def check_plan(out, numbers):
    assert out.startswith("reached: ")
    assert numbers[-1] < 5.0


def check_diagram(out, numbers):
    assert "Pushes seen: 4." in out
    (x, y), (true_x, true_y) = (map(float, pair.split()) for pair in re.findall(r"\[(.*?)\]", out))
    assert abs(x - true_x) < 5.0 and abs(y - true_y) < 5.0


def check_arm(out, numbers):
    assert "Can the arm do it? Yes." in out
    _, _, y = numbers
    assert y > 0.02


def check_camera(out, numbers):
    area, *poses = numbers
    assert abs(area - 96.0) < 5.0
    turns = poses[2::3]
    assert abs(turns[1] - turns[0] - 5.7) < 0.5 and abs(turns[2] - turns[0] - 17.2) < 0.5


def check_objects(out, numbers):
    plate_area, block_area = numbers[:2]
    assert abs(plate_area - 96.0) < 5.0 and abs(block_area - 40.0) < 3.0
    before = np.reshape(numbers[2:6], (2, 2))
    after = np.reshape(numbers[-4:], (2, 2))
    assert np.abs(after - before - [[50.0, 0.0], [20.0, 0.0]]).max() < 1.5


def check_regulator(out, numbers):
    aside, askew, regulated, straight = numbers[-4:]
    assert abs(regulated) < 1.0 < abs(aside) and abs(straight) < 1.0 < abs(askew)


def check_warnings(out, numbers):
    spreads = numbers[0:9:3]
    assert spreads[0] > spreads[2]
    assert numbers[8] < 3.0


CHECKS = {
    "simulate_one_push": check_push,
    "learn_from_my_csv": check_learning,
    "plan_to_a_goal": check_plan,
    "in_my_diagram": check_diagram,
    "my_arm": check_arm,
    "my_camera": check_camera,
    "my_objects": check_objects,
    "linearize_in_drake": check_regulator,
    "what_pushes_cannot_say": check_warnings,
}


@pytest.mark.parametrize("name", CHECKS)
def test_a_program_does_what_it_says(name, capsys, tmp_path, monkeypatch):
    CHECKS[name](*run(name, capsys, tmp_path, monkeypatch))


def test_every_program_is_tried_listed_and_short():
    page = (EXAMPLES.parent / "howto/examples.md").read_text()
    with_jax = {"learn_in_jax", "policy_in_jax"}
    programs = {path.stem for path in EXAMPLES.glob("*.py") if "launch" not in path.name}
    assert programs == CHECKS.keys() | with_jax
    for name in programs:
        text = (EXAMPLES / f"{name}.py").read_text()
        assert f"../examples/{name}.py" in page
        assert 15 <= len(text.splitlines()) <= 75, name
        assert ast.get_docstring(ast.parse(text))


@pytest.mark.parametrize("arm", ["ur5e", "xarm6"])
def test_a_launch_file_renames_topics_that_there_are(arm):
    text = (EXAMPLES / f"{arm}.launch.py").read_text()
    compile(text, arm, "exec")
    topics = {
        value
        for name, value in {**vars(ros2_topics), **vars(ros2_pictures)}.items()
        if name.isupper() and isinstance(value, str)
    }
    renamed = re.findall(r'"([\w/]+):=', text)
    assert renamed and set(renamed) <= topics
