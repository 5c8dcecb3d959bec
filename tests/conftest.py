"""`--budget SECONDS`: tests that would begin later are skipped, and say so; CI runs slow ones while there is time."""

import signal
import subprocess
import sys
from time import monotonic

import pytest

BEGIN = monotonic()


WARM_UP = "from gridpush_drake.dynamics.warm_up import compile_rollouts; compile_rollouts()"
"""Python code that compiles the kernels, or finds them compiled."""


def pytest_configure(config):
    """Prepares what a suite takes from its surroundings.

    A suite that is run under nohup inherits an ignored SIGHUP; the tests of signals need it. And
    kernels are compiled before several workers begin, so that no test is timed while one waits.
    """
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    begins_workers = not hasattr(config, "workerinput") and config.getoption("numprocesses", None)
    if begins_workers and not config.getoption("collectonly"):
        subprocess.run([sys.executable, "-c", WARM_UP], check=False)


def pytest_addoption(parser):
    parser.addoption(
        "--budget", type=float, metavar="SECONDS", help="After so long no further test begins."
    )


def pytest_runtest_setup(item):
    budget = item.config.getoption("--budget")
    if budget is not None and monotonic() - BEGIN > budget:
        pytest.skip(f"the budget of {budget:g} s is used up")
