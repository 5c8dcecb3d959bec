"""Two options for CI, which has no time for everything.

`--budget SECONDS`: tests that would begin later are skipped, and named at the end. `--per-file N`: of each file only
the first N tests are run, a parametrized one counting once, with its first parameters.
"""

import gc
import os
import signal
import subprocess
import sys
from time import monotonic

import pytest

BEGIN = monotonic()


USED_UP = "the budget is used up"
"""Why a test was skipped for which there was no time."""

WARM_UP = "from gridpush_drake.dynamics.warm_up import compile_rollouts; compile_rollouts()"
"""Python code that compiles the kernels, or finds them compiled."""


GC_THRESHOLDS = (20_000, 20, 20)
"""How many new objects Python makes before it looks for garbage among them, and how many such looks
before it looks among older ones. Its own 700 take a twelfth of the suite's time."""


def pytest_configure(config):
    """Prepares what a suite takes from its surroundings.

    A suite that is run under nohup inherits an ignored SIGHUP; the tests of signals need it. And
    kernels are compiled before several workers begin, so that no test is timed while one waits.
    Bytecode is kept whatever the surroundings say, as workers and commands import the same files.
    """
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    begins_workers = not hasattr(config, "workerinput") and config.getoption("numprocesses", None)
    if not begins_workers:
        gc.disable()  # until all is imported; see `pytest_collection_finish`
    if begins_workers and not config.getoption("collectonly"):
        subprocess.run([sys.executable, "-c", WARM_UP], check=False)


def pytest_addoption(parser):
    parser.addoption(
        "--budget", type=float, metavar="SECONDS", help="After so long no further test begins."
    )
    parser.addoption(
        "--per-file", type=int, metavar="N", help="Of each file only the first N tests are run."
    )


def pytest_collection_modifyitems(config, items):
    limit = config.getoption("--per-file")
    if limit is None:
        return
    taken = {}
    kept = []
    for item in items:
        names = taken.setdefault(item.path, set())
        name = item.nodeid.partition("[")[0]
        if len(names) < limit and name not in names:
            names.add(name)
            kept.append(item)
    config.hook.pytest_deselected(items=[item for item in items if item not in set(kept)])
    items[:] = kept


def pytest_collection_finish():
    """Exempts what was imported and collected from Python's search for garbage.

    There are millions of such objects, and each search would go through all of them.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(*GC_THRESHOLDS)
    gc.enable()


def pytest_runtest_setup(item):
    budget = item.config.getoption("--budget")
    if budget is not None and monotonic() - BEGIN > budget:
        pytest.skip(f"{USED_UP}: {budget:g} s")


@pytest.fixture
def undrawn(monkeypatch):
    """Leaves each figure of a report empty: most of a report's time is that of drawing them."""
    empty = b'<svg xmlns="http://www.w3.org/2000/svg"/>'
    monkeypatch.setattr("gridpush_drake.report.page.to_svg", lambda figure: empty)


def pytest_terminal_summary(terminalreporter):
    """Names the tests for which there was no time."""
    skipped = terminalreporter.stats.get("skipped", [])
    late = [each.nodeid for each in skipped if USED_UP in str(each.longrepr)]
    if late:
        terminalreporter.section(f"not run, for the budget was used up: {len(late)}")
        for name in late:
            terminalreporter.line(name)
