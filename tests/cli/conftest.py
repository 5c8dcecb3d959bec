import pytest

from gridpush_drake.cli.shell.options import compile_kernels
from gridpush_drake.identification.model_file import write_model
from gridpush_drake.multibody.ground_truth import sample_ground_truth
from tests.helpers.command_line import run_gridpush
from tests.helpers.made_identifications import make_block, make_identification
from tests.helpers.simulated_pushes import make_pushes


@pytest.fixture(scope="session", autouse=True)
def kernels():
    """Compiled before any command runs, so that none has to say that it compiles them."""
    compile_kernels()


@pytest.fixture
def gridpush(capsys):
    def run(*args):
        return run_gridpush(capsys, *args)

    return run


@pytest.fixture
def refuses(gridpush, tmp_path):
    """Runs a command that must refuse: exit code 2, one line that says so, and no new file."""

    def run(*args, says):
        before = sorted(tmp_path.rglob("*"))
        outcome = gridpush(*args)
        assert outcome.code == 2, outcome
        assert outcome.out == ""
        assert outcome.err.startswith("gridpush: error: ")
        assert outcome.err.count("\n") == 1
        assert "Traceback" not in outcome.err
        for text in says:
            assert str(text) in outcome.err
        assert sorted(tmp_path.rglob("*")) == before

    return run


@pytest.fixture
def block(tmp_path):
    path = tmp_path / "block.yaml"
    make_block().write_yaml(path)
    return path


@pytest.fixture
def pushes(tmp_path):
    path = tmp_path / "pushes.csv"
    obj = make_block()
    make_pushes(obj, sample_ground_truth(obj, 3), 5, seed=3).write_csv(path)
    return path


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "model.yaml"
    write_model(path, make_identification())
    return path
