"""The push that the doors to JAX and torch are tried with."""

import pytest

from gridpush_drake.interop.differentiable import ARGUMENT_NAMES, PushFunction
from tests.interop.push_functions import REGIMES, make_case


@pytest.fixture(scope="session")
def case():
    return make_case()


@pytest.fixture(params=REGIMES)
def function(case, request):
    """The `simulate` of the test's module, of the six arguments by position."""
    setting = case.make_setting(request.param)

    def run(*values):
        given = dict(zip(ARGUMENT_NAMES, values, strict=True))
        return request.module.simulate(case.obj, setting, **given)

    run.expected = PushFunction(case.obj, setting)
    return run
