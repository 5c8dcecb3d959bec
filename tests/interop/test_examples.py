"""The programs in `docs/examples` that need JAX."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "docs/examples"

pytest.importorskip("jax", reason="jax is not installed")
pytest.importorskip("optax", reason="optax is not installed")


def run(name):
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / name)],
        capture_output=True,
        text=True,
        check=False,
        env={"PYTHONPATH": str(ROOT), "PATH": ""},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout, [
        float(number) for number in re.findall(r"(\d+\.\d+) (?:mm|cm)", done.stdout)
    ]


def test_a_map_is_learned_with_optax():
    out, (before, after, off) = run("learn_in_jax.py")
    assert after < 0.1 * before, out
    assert off < 2.0


def test_a_policy_is_trained_through_the_simulator():
    out, (before, after) = run("policy_in_jax.py")
    assert after < 0.7 * before, out


def test_the_pages_block_runs(capsys):
    page = (ROOT / "docs/howto/autodiff.md").read_text()
    (block,) = re.findall(r"```\{code-block\} python\n(.*?)```", page, re.DOTALL)
    exec(compile(block, "autodiff.md", "exec"), {})
    assert capsys.readouterr().out.startswith("(2, ")
