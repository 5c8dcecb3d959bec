"""`--budget SECONDS`: tests that would begin later are skipped, and say so; CI runs slow ones while there is time."""

import signal
from time import monotonic

import pytest

BEGIN = monotonic()


def pytest_configure():
    """A suite that is run under nohup inherits an ignored SIGHUP; the tests of signals need it."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def pytest_addoption(parser):
    parser.addoption(
        "--budget", type=float, metavar="SECONDS", help="After so long no further test begins."
    )


def pytest_runtest_setup(item):
    budget = item.config.getoption("--budget")
    if budget is not None and monotonic() - BEGIN > budget:
        pytest.skip(f"the budget of {budget:g} s is used up")
