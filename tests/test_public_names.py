"""The public names: what README and tutorials may import, and no more."""

import ast
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import gridpush_drake

PUBLIC = """
AddGridObject CellParameters ContactPointController ForcePush GraspCommand GridIdentifier GridLcpSystem GridObject
GridPushError Identification MakePushStation Model Motion ObservedPush PhysicalPrior Physics PlanarPoseSensor
PokePolicy PreGraspController Push PushCommand PushConstraints PushExecutor PushLog PushScenario SetPartner
SupportSurface WriteSdf
identify list_shipped_objects optimize_contact plan_pregrasp plan_pushes predict read_model read_scenario simulate
simulate_batch write_model
"""

STUBS = sorted(path for path in Path(gridpush_drake.__file__).parent.rglob("__init__.pyi"))


def test_the_list():
    assert gridpush_drake.__all__ == PUBLIC.split()
    assert sorted(dir(gridpush_drake)) == PUBLIC.split()


@pytest.mark.parametrize("stub", STUBS, ids=lambda path: path.parent.name)
def test_every_name_is_there_and_is_no_module(stub):
    folder = stub.parent.relative_to(Path(gridpush_drake.__file__).parent)
    package = import_module(".".join(["gridpush_drake", *folder.parts]))
    assert package.__all__
    for name in package.__all__:
        assert not isinstance(getattr(package, name), type(ast)), name
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = package.no_such_name


def test_importing_dynamics_and_its_pushes_imports_no_compiler():
    code = "import sys, gridpush_drake.dynamics.push; print('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.split() == ["False"]
