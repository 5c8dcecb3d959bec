"""What the packages promise to export, whatever was imported before."""

import subprocess
import sys
from importlib import import_module

import pytest

PACKAGES = [
    "gridpush_drake.dynamics",
    "gridpush_drake.dynamics.kernels",
    "gridpush_drake.dynamics.reference",
    "gridpush_drake.identification",
]


@pytest.mark.parametrize("name", PACKAGES)
def test_every_public_name_is_there_and_none_is_a_module(name):
    package = import_module(name)
    assert len(set(package.__all__)) == len(package.__all__)
    for public in package.__all__:
        assert not isinstance(getattr(package, public), type(sys)), public
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = package.no_such_name


def test_importing_dynamics_and_its_pushes_imports_no_compiler():
    code = "import sys, gridpush_drake.dynamics.push; print('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.split() == ["False"]
