"""The cache of compiled kernels: shared by checkouts of the same sources, renewed by a change, read where read-only."""

import os
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from gridpush_drake.dynamics.kernels import compiled
from gridpush_drake.dynamics.kernels.compiled import calc_digest

USER = """
import sys
sys.path.insert(0, {folder!r})
from user import double
print(double(2.0), double.stats.cache_hits[double.signatures[0]] if double.stats.cache_hits else 0)
"""

SOURCE = """
from gridpush_drake.dynamics.kernels.compiled import kernel

@kernel(allocates=False)
def double(x):
    return {factor} * x
"""


def call_user(folder, cache, factor):
    """Calls a kernel that stands in `folder` from a process of its own; returns its value and the cache's hits."""
    folder.mkdir(exist_ok=True)
    (folder / "user.py").write_text(SOURCE.format(factor=factor))
    shutil.rmtree(folder / "__pycache__", ignore_errors=True)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", USER.format(folder=str(folder))], check=True, capture_output=True, text=True,
        env=environment, cwd=Path(__file__).parents[3],
    )  # fmt: skip
    value, hits = done.stdout.split()
    return float(value), int(hits)


def test_a_kernel_is_compiled_once_for_all_checkouts_and_again_when_its_file_changes(tmp_path):
    cache = tmp_path / "cache"
    assert call_user(tmp_path / "one", cache, 2.0) == (4.0, 0)
    assert call_user(tmp_path / "other", cache, 2.0) == (4.0, 1)
    assert call_user(tmp_path / "other", cache, 3.0) == (6.0, 0)


def test_a_cache_that_cannot_be_written_is_read(tmp_path, monkeypatch):
    source = Path(compiled.__file__)
    folder = tmp_path / f"kernels-{calc_digest(source)}"
    folder.mkdir()
    (folder / "something.nbi").write_bytes(b"")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(compiled.tempfile, "TemporaryFile", refuse)
    assert compiled.find_cache_folder.__wrapped__(source) == folder
    (folder / "something.nbi").unlink()
    assert compiled.find_cache_folder.__wrapped__(source).parent == Path(
        compiled.tempfile.gettempdir()
    )


def refuse(*args, **kwargs):
    raise PermissionError("read-only")


@pytest.mark.parametrize("change", ["edit", "add"])
def test_the_digest_follows_every_file_of_the_folder(tmp_path, monkeypatch, change):
    kernels, copy = Path(compiled.__file__).parent, tmp_path / "kernels"
    shutil.copytree(kernels, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(compiled, "KERNELS", copy)
    calc = compiled.calc_digest.__wrapped__
    assert calc(copy / "step.py") == calc_digest(kernels / "step.py")
    if change == "edit":
        (copy / "contact.py").write_text((copy / "contact.py").read_text() + "\n# changed\n")
    else:
        (copy / "new_law.py").write_text("")
    assert calc(copy / "step.py") != calc_digest(kernels / "step.py")


def test_folders_that_nobody_used_for_long_are_removed_by_whoever_makes_a_new_one(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    source, now = Path(compiled.__file__), time.time()
    mine, kept = (
        tmp_path / f"kernels-{calc_digest(source)}",
        [f"kernels-{'a' * 16}", "kernels-mine", "other"],
    )
    for name, age in (
        ("kernels-" + "0" * 16, 1.01),
        (kept[0], 0.99),
        (kept[1], 9.0),
        (kept[2], 9.0),
    ):
        (tmp_path / name).mkdir()
        (tmp_path / name / "something.nbi").write_bytes(b"")
        os.utime(tmp_path / name, (now, now - age * compiled.UNUSED))
    find = compiled.find_cache_folder.__wrapped__
    with ThreadPoolExecutor(4) as pool:
        assert set(pool.map(find, [source] * 8)) == {mine}
    assert {path.name for path in tmp_path.iterdir()} == {mine.name, *kept}
    (mine / "something.nbi").write_bytes(b"")
    os.utime(mine, (now, now - 9 * compiled.UNUSED))
    assert find(source) == mine and time.time() - mine.stat().st_mtime < compiled.UNUSED
