"""`gridpush warm-up`, whatever becomes of the second process."""

import json

import pytest

from gridpush_drake.cli import kernels


def test_says_where_the_kernels_are_kept_and_whether_they_were_compiled(gridpush):
    found = json.loads(gridpush("warm-up", "--json").out)
    assert found["compiled"] is False
    assert "kernels-" in found["folder"]
    assert gridpush("warm-up").out.startswith(
        "The simulation was compiled before; the compiled code is"
    )


@pytest.mark.parametrize("code", ["raise SystemExit(3)", "import time; time.sleep(60)", "1 +"])
def test_a_second_process_that_fails_or_hangs_is_not_needed(gridpush, monkeypatch, code):
    monkeypatch.setattr(kernels, "is_compiled", lambda: False)
    monkeypatch.setattr(kernels, "APART", code)
    monkeypatch.setattr(kernels, "PATIENCE", 0.1)
    outcome = gridpush("warm-up")
    assert (outcome.code, outcome.err) == (0, "")
