"""A scenario is resolved once: everybody takes the record, and nothing is read, drawn or solved again."""

from collections import Counter

import pytest

from gridpush_drake import files
from gridpush_drake.errors import ScenarioError
from gridpush_drake.station.scene import resolve as resolving
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.schema.scenario_file import read_scenario
from gridpush_drake.station.simulated import plant as station_plant
from gridpush_drake.station.simulated.push_station import MakePushStation
from gridpush_drake.station.tasks.task import StationTask
from tests.helpers.command_line import run_gridpush
from tests.helpers.renderer import require_renderer


@pytest.fixture
def counts(monkeypatch):
    """How often what is slow or hidden is done, by its name, and files are opened, by theirs."""
    found: Counter[str] = Counter()

    def count(module, name, note=None):
        work = getattr(module, name)

        def counted(*args, **kwargs):
            found[name if note is None else note(*args)] += 1
            return work(*args, **kwargs)

        monkeypatch.setattr(module, name, counted)

    for module, name in (
        (resolving, "MakeTruth"),
        (station_plant, "MakeTruth"),
        (resolving, "MakeSupport"),
        (station_plant, "MakeSupport"),
        (resolving, "CalcStartPosture"),
        (resolving, "MakeControlPlant"),
        (resolving, "find_robot"),
        (resolving, "AddScene"),
        (station_plant, "AddScene"),
    ):
        count(module, name)
    count(files, "open_file", lambda path, *_: f"file {path}")
    return found


def check_counts(counts, scenes):
    once = ("MakeTruth", "MakeSupport", "CalcStartPosture", "MakeControlPlant", "find_robot")
    assert {name: counts[name] for name in once} == dict.fromkeys(once, 1)
    assert counts["AddScene"] == scenes
    opened = {name: times for name, times in counts.items() if name.startswith("file ")}
    assert set(opened.values()) == {1}, opened
    for end in ("grasp.yaml", "claw_hammer.yaml", "robot.yaml", "finger.yaml", "gripper.yaml"):
        assert sum(name.endswith(end) for name in opened) == 1, (end, opened)


def run_demo(capsys, monkeypatch, tmp_path, camera):
    """Runs the command up to where the robot would move: a run is interrupted at its first step."""

    def interrupt(task, *_, **__):
        task.begin()
        raise KeyboardInterrupt

    monkeypatch.setattr(StationTask, "run", interrupt)
    return run_gridpush(
        capsys, "demo", "--scenario", "grasp", "--object", "claw_hammer", "--camera", camera,
        "--out", tmp_path / "demo",
    )  # fmt: skip


@pytest.mark.slow
def test_a_demo_reads_draws_and_solves_everything_once(capsys, counts, monkeypatch, tmp_path):
    assert run_demo(capsys, monkeypatch, tmp_path, "ideal").code == 130
    check_counts(counts, scenes=2)  # what is checked, and the world


@pytest.mark.slow
def test_a_demo_with_pictures_builds_the_photograph_s_scene_and_the_world_s(
    capsys, counts, monkeypatch, tmp_path
):
    require_renderer()
    assert run_demo(capsys, monkeypatch, tmp_path, "rgbd").code == 130
    check_counts(counts, scenes=2)


def test_a_record_is_resolved_no_further_and_serves_several_stations(counts):
    resolved = resolve(read_scenario("grasp"))
    assert resolve(resolved) is resolved
    first, second = MakePushStation(resolved), MakePushStation(resolved)
    assert first.truth is second.truth is resolved.truth
    assert first.home == second.home and counts["find_robot"] == 1
    assert counts["CalcStartPosture"] == 1 and counts["MakeTruth"] == 1


def test_another_seed_draws_another_truth(counts):
    station = MakePushStation(resolve(PushScenario(seed=3)))
    for seed in (3, 4, 3):
        context = station.CreateDefaultContext()
        station.SetStart(context, seed)
        mass = station.GetTruth(context).mass
        same = (mass == station.truth.mass).all()
        assert same == (seed == 3)
    assert counts["MakeTruth"] == 2  # seed 3's once, seed 4's once


def test_what_makes_no_sense_names_its_file():
    with pytest.raises(
        ScenarioError, match=r"^mine\.yaml: object_pose is .*not wholly on the table"
    ):
        resolve(PushScenario(object_pose=[3.0, 0.0, 0.0]), "mine.yaml")
