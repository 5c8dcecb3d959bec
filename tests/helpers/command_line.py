"""The `gridpush` command, run within the test's process."""

from dataclasses import dataclass

import pytest

from gridpush_drake.cli.main import main


@dataclass(frozen=True)
class Outcome:
    """What a run left: exit code, standard output, standard error."""

    code: int
    out: str
    err: str


def run_gridpush(capsys: pytest.CaptureFixture[str], *args: object) -> Outcome:
    """Runs `gridpush` with these arguments."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as exited:
        main([str(arg) for arg in args])
    printed = capsys.readouterr()
    return Outcome(int(exited.value.code or 0), printed.out, printed.err)
