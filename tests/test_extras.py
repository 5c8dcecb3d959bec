"""What is installed with an extra only: nothing else needs it, and whoever needs it is told its name."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from gridpush_drake.cli.bench.group import BENCHES
from gridpush_drake.cli.main import COMMANDS
from gridpush_drake.errors import GridPushError, MissingExtraError
from gridpush_drake.extras import import_extra
from gridpush_drake.multibody.ground_truth import sample_ground_truth
from tests.helpers.made_identifications import make_block
from tests.helpers.simulated_pushes import make_pushes

PROJECT = Path(__file__).parents[1] / "pyproject.toml"

OF_EXTRAS = {
    "clarabel",
    "cma",
    "distributed",
    "gym-pusht",
    "gymnasium",
    "h5py",
    "jax",
    "mujoco",
    "pyarrow",
    "pymunk",
    "rerun-sdk",
    "rosbags",
    "torch",
}
"""Packages that `pip install .` does not install."""

NOT_FOR_TESTS = {"gym-pusht", "jax", "mujoco", "pyarrow", "pymunk", "rerun-sdk", "torch"}
"""Packages that are not needed to work on the project: tests that use them are skipped without.

Arrow, JAX, MuJoCo, Rerun and torch are large, and gym-pusht brings another build of OpenCV."""

MISSING = """
import gc
gc.disable()  # it would look through all that is imported again and again
import sys

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {packages}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Missing())
"""
"""Makes a process one in which no extra is installed, or only some packages of extras are."""


def run_without_extras(code, but=frozenset(), **settings):
    packages = sorted(name.replace("-", "_") for name in OF_EXTRAS - but)
    return subprocess.run(
        [sys.executable, "-c", MISSING.format(packages=packages) + code],
        capture_output=True,
        text=True,
        **settings,
    )


def read_project():
    return tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]


def name_packages(requirements):
    return {re.match(r"[\w-]+", requirement)[0] for requirement in requirements}


def test_only_the_extras_bring_them():
    project = read_project()
    extras = project["optional-dependencies"]
    assert not name_packages(project["dependencies"]) & OF_EXTRAS
    for_users = [extras[name] for name in extras.keys() - {"dev", "docs"}]
    assert set().union(*map(name_packages, for_users)) == OF_EXTRAS


def test_whoever_works_on_the_project_gets_what_its_tests_need():
    assert (
        name_packages(read_project()["optional-dependencies"]["dev"]) >= OF_EXTRAS - NOT_FOR_TESTS
    )


def test_every_command_and_the_demo_work_without_extras():
    commands = [*COMMANDS.values(), *(BENCHES[name] for name in BENCHES if name != "gym")]
    modules = sorted(command.target.partition(":")[0] for command in commands)
    code = f"import importlib\nfor name in {modules}:\n    importlib.import_module(name)\n"
    done = run_without_extras(code)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_the_site_describes_every_command_with_its_own_extra_alone():
    docs = name_packages(read_project()["optional-dependencies"]["docs"])
    modules = sorted(bench.target.partition(":")[0] for bench in BENCHES.values())
    code = f"import importlib\nfor name in {modules}:\n    importlib.import_module(name)\n"
    done = run_without_extras(code, but=docs)
    assert done.returncode == 0, done.stderr


def test_a_module_that_needs_an_extra_names_it():
    wanted = {
        "interop.jax": ("jax", "jax"),
        "interop.torch": ("torch", "torch"),
        "dynamics.reference.maximal_solvers": ("clarabel", "reference"),
        "dynamics.reference.isotropic_socp": ("clarabel", "reference"),
    }
    code = (
        "import importlib\n"
        "from gridpush_drake.errors import MissingExtraError\n"
        f"for module in {list(wanted)}:\n"
        "    try:\n"
        "        importlib.import_module(f'gridpush_drake.{module}')\n"
        "    except MissingExtraError as error:\n"
        "        print(error)\n"
    )
    done = run_without_extras(code)
    assert done.stdout.splitlines() == [
        f"{package}: is not installed; expected pip install '.[{extra}]', in a clone of the repository"
        for package, extra in wanted.values()
    ], done.stderr


def test_a_command_that_needs_an_extra_says_so_in_one_line(tmp_path):
    obj = make_block()
    obj.write_yaml(tmp_path / "block.yaml")
    make_pushes(obj, sample_ground_truth(obj, 3), 2, seed=3).write_csv(tmp_path / "pushes.csv")
    files = ["block.yaml", "pushes.csv", "--out", "model.yaml"]
    wanted = {
        "baselines": ["identify", *files, "--method", "cma_es"],
        "gym": ["bench", "gym", "--quick"],
        "pusht": ["bench", "pusht", "--quick"],
        "bench": ["bench", "truth", "--quick"],
    }
    code = (
        "import sys\n"
        "from gridpush_drake.cli.main import main\n"
        f"for args in {list(wanted.values())}:\n"
        "    try:\n"
        "        main(args)\n"
        "    except SystemExit as ended:\n"
        "        print('ended with', ended.code, file=sys.stderr)\n"
    )
    done = run_without_extras(code, cwd=tmp_path)
    assert done.returncode == 0
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    lines = done.stderr.splitlines()
    ends = [i for i, line in enumerate(lines) if line.startswith("ended with")]
    assert [lines[i] for i in ends] == ["ended with 2"] * len(wanted)
    for end, extra in zip(ends, wanted, strict=True):
        assert lines[end - 1].startswith("gridpush: error: ")
        assert f"expected pip install '.[{extra}]'" in lines[end - 1]
    assert "cma: is not installed" in lines[ends[0] - 1]
    assert not (tmp_path / "model.yaml").exists()


def test_another_error_within_a_package_is_not_hidden(tmp_path, monkeypatch):
    (tmp_path / "needs_another.py").write_text("import nothing_of_this_name\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ModuleNotFoundError, match="nothing_of_this_name"):
        import_extra("needs_another", "bench")
    with pytest.raises(MissingExtraError, match=r".\[bench\]"):
        import_extra("nothing_of_this_name", "bench")
    assert issubclass(MissingExtraError, GridPushError)
