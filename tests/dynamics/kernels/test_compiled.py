"""The cache of compiled kernels: shared by checkouts of the same sources, renewed by a change, read where read-only."""

import hashlib
import os
import pickle
import random
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numba
import pytest

from gridpush_drake.dynamics.kernels import compiled
from gridpush_drake.dynamics.kernels.compiled import calc_digest, hash_own_records
from gridpush_drake.dynamics.kernels.forward_sensitivity import step_columns
from gridpush_drake.dynamics.kernels.inputs import Body
from gridpush_drake.dynamics.warm_up import compile_rollouts, find_columns_signature

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
    (folder / "something.nbc").write_bytes(b"")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(compiled.tempfile, "TemporaryFile", refuse)
    assert compiled.find_cache_folder.__wrapped__(source) == folder
    (folder / "something.nbc").unlink()
    assert compiled.find_cache_folder.__wrapped__(source) is None


def refuse(*args, **kwargs):
    raise PermissionError("read-only")


@pytest.mark.parametrize("change", ["edit", "add"])
def test_the_digest_follows_every_file_of_the_folder(tmp_path, monkeypatch, change):
    kernels, copy = Path(compiled.__file__).parent, tmp_path / "kernels"
    digest = calc_digest(kernels / "step.py")
    shutil.copytree(kernels, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(compiled, "KERNELS_FOLDER", copy)
    calc = compiled.calc_digest.__wrapped__
    assert calc(copy / "step.py") == digest
    if change == "edit":
        (copy / "contact" / "contact.py").write_text(
            (copy / "contact" / "contact.py").read_text() + "\n# changed\n"
        )
    else:
        (copy / "new_law.py").write_text("")
    assert calc(copy / "step.py") != digest


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
        os.utime(tmp_path / name, (now, now - age * compiled.MAX_UNUSED_TIME))
    find = compiled.find_cache_folder.__wrapped__
    with ThreadPoolExecutor(4) as pool:
        assert set(pool.map(find, [source] * 8)) == {mine}
    assert {path.name for path in tmp_path.iterdir()} == {mine.name, *kept}
    (mine / "something.nbi").write_bytes(b"")
    os.utime(mine, (now, now - 9 * compiled.MAX_UNUSED_TIME))
    assert find(source) == mine and time.time() - mine.stat().st_mtime < compiled.MAX_UNUSED_TIME


class User:
    """A kernel that doubles a number, and its filled cache.

    Attributes:
        source: the file of the kernel's source.
        cache: the folder that NUMBA_CACHE_DIR names.
        file: the one compiled kernel in it.
    """

    def __init__(self, folder, monkeypatch, capsys):
        self.source, self._capsys, self._monkeypatch = folder / "user.py", capsys, monkeypatch
        self.source.write_text(SOURCE.format(factor=2.0))
        self.cache = folder / "cache"
        self.call()
        (self.file,) = self.cache.glob("*/*.nbc")

    def call(self, cache=None):
        """Calls the kernel as a new process does; returns value, hits, and the lines on standard error."""
        forget()
        self._monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache or self.cache))
        specification = spec_from_file_location("user", self.source)
        module = module_from_spec(specification)
        specification.loader.exec_module(module)
        self._capsys.readouterr()
        value = module.double(2.0)
        hits = sum(module.double.stats.cache_hits.values())
        return value, hits, self._capsys.readouterr().err.splitlines()


def forget():
    compiled.find_cache_folder.cache_clear()
    compiled._say_once.cache_clear()


@pytest.fixture
def user(tmp_path, monkeypatch, capsys):
    yield User(tmp_path, monkeypatch, capsys)
    forget()


def test_the_first_call_that_compiles_says_so_and_one_that_finds_all_compiled_says_nothing(user):
    assert user.call() == (4.0, 1, [])
    user.file.unlink()
    assert user.call() == (4.0, 0, [compiled.COMPILING_NOTICE])


@pytest.mark.parametrize(("arrives", "hits"), [(True, 1), (False, 0)])
def test_a_kernel_that_another_process_compiles_is_waited_for(user, tmp_path, arrives, hits):
    """The file comes at the third look, or the other process ends without it."""
    kept = user.file.rename(tmp_path / "kept.nbc")
    looks = []

    def is_at_work():
        looks.append(user.file.exists())
        if len(looks) < 3:
            return True
        if arrives:
            kept.rename(user.file)
        return arrives

    with compiled.filled_by(compiled.Others(frozenset({user.source}), is_at_work)):
        assert user.call() == (4.0, hits, [compiled.COMPILING_NOTICE])
    assert looks == [False] * 3
    user.file.unlink()
    with compiled.filled_by(compiled.Others(frozenset(), is_at_work)):
        user.call()
    assert len(looks) == 3


def spoil(content, how, seed):
    """A compiled kernel's file as a full disk, a fault of it, or another program leaves it."""
    rng = random.Random(seed)
    if how == "cut":
        return content[: rng.randrange(len(content))]
    if how == "flipped":
        at = rng.randrange(len(content))
        return content[:at] + bytes([content[at] ^ (1 << rng.randrange(8))]) + content[at + 1 :]
    return rng.randbytes(rng.choice((0, 7, 32, 5000)))


@pytest.mark.parametrize("how", ["cut", "flipped", "garbage"])
def test_a_damaged_file_is_compiled_anew_and_one_line_names_the_folder(user, how):
    user.file.write_bytes(spoil(user.file.read_bytes(), how, seed=len(how)))
    damaged = f"gridpush: a damaged file in {user.file.parent} is compiled anew"
    assert user.call() == (4.0, 0, [damaged, compiled.COMPILING_NOTICE])
    assert user.call() == (4.0, 1, [])


def test_no_damaged_content_is_ever_unpickled(tmp_path):
    file = tmp_path / "kernel.nbc"
    compiled._write(file, b"any content")
    assert compiled._read(file) == b"any content"
    whole = file.read_bytes()
    for seed in range(200):
        for how in ("cut", "flipped", "garbage"):
            file.write_bytes(spoil(whole, how, seed))
            with pytest.raises(ValueError):
                compiled._read(file)


class Hostile:
    """A pickle that leaves a trace where it is read."""

    def __init__(self, trace):
        self.trace = trace

    def __reduce__(self):
        return Path.touch, (self.trace,)


def plant(file, trace):
    content = pickle.dumps(Hostile(trace))
    file.write_bytes(hashlib.sha256(content).digest() + content)


def test_a_pickle_runs_from_a_folder_of_ones_own_so_that_the_tests_below_can_fail(user, tmp_path):
    plant(user.file, tmp_path / "trace")
    user.call()
    assert (tmp_path / "trace").exists()


@pytest.mark.parametrize(
    ("place", "mode", "said"),
    [
        ("folder", 0o777, "can be written by every user"),
        ("folder", 0o1777, "can be written by every user"),
        ("folder", 0o775, "can be written by a group of users"),
        ("above", 0o777, "can be written by every user"),
        ("file", 0o666, None),
    ],
)
def test_what_others_can_write_is_not_read(user, tmp_path, place, mode, said):
    plant(user.file, tmp_path / "trace")
    {"folder": user.file.parent, "above": user.cache, "file": user.file}[place].chmod(mode)
    value, hits, lines = user.call()
    assert (value, hits) == (4.0, 0)
    assert not (tmp_path / "trace").exists()
    assert lines[-1] == compiled.COMPILING_NOTICE
    assert len(lines) == (1 if said is None else 2)
    if said is not None:
        assert lines[0].startswith(f"gridpush: {user.cache} is not used for compiled kernels: ")
        assert lines[0].endswith(said)


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give files away")
@pytest.mark.parametrize("place", ["folder", "above", "file"])
def test_what_belongs_to_another_user_is_not_read(user, tmp_path, place):
    plant(user.file, tmp_path / "trace")
    os.chown(
        {"folder": user.file.parent, "above": user.cache, "file": user.file}[place], 4242, 4242
    )
    assert user.call()[:2] == (4.0, 0)
    assert not (tmp_path / "trace").exists()


def test_a_link_leads_no_further_than_to_what_only_its_user_can_change(user, tmp_path):
    plant(user.file, tmp_path / "trace")
    user.file.parent.chmod(0o777)
    other = tmp_path / "other"
    other.mkdir()
    (other / user.file.parent.name).symlink_to(user.file.parent)
    assert user.call(other)[:2] == (4.0, 0)
    user.file.parent.chmod(0o755)
    user.file.rename(tmp_path / "kernel")
    user.file.symlink_to(tmp_path / "kernel")
    assert user.call()[:2] == (4.0, 0)
    assert not (tmp_path / "trace").exists()


@pytest.mark.parametrize("given", ["", "relative", "./relative"])
def test_a_cache_home_that_is_empty_or_relative_counts_as_unset(given, monkeypatch, tmp_path):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", given)
    monkeypatch.setenv("HOME", str(tmp_path))
    assert compiled._list_places()[0] == tmp_path / ".cache" / "gridpush_drake"


def test_the_home_folder_is_asked_for_only_where_it_is_needed(monkeypatch, tmp_path):
    def refuse_home():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(compiled.Path, "home", refuse_home)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert compiled._list_places() == [tmp_path]
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    assert compiled._list_places() == [compiled.KERNELS_FOLDER / "__pycache__"]
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert compiled._list_places()[0] == tmp_path / "gridpush_drake"


def test_no_place_is_predictable_by_others(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "missing" / "deep"))
    folder = compiled.find_cache_folder.__wrapped__(Path(compiled.__file__))
    assert folder.parent == tmp_path / "missing" / "deep"
    assert all(part.stat().st_mode & 0o022 == 0 for part in (folder, *folder.parents[:2]))
    monkeypatch.setattr(compiled, "_list_places", lambda: [])
    assert compiled.find_cache_folder.__wrapped__(Path(compiled.__file__)) is None


def test_the_second_process_compiles_the_columns_for_the_types_that_the_rollout_calls_them_with():
    compile_rollouts()
    cache = compiled.get_cache(step_columns)
    files = cache.list_files()
    assert files
    codegen = step_columns.targetctx.codegen()
    assert files == [cache.find_file(find_columns_signature(), codegen)]


def test_a_kernel_is_compiled_anew_when_a_friction_law_of_the_user_s_own_changes(
    tmp_path, monkeypatch
):
    """What was compiled for a law's data holds the law's functions, which stand in another file."""
    words = []
    for folder, arm in (("one", 1.0), ("same", 1.0), ("changed", 2.0)):
        path = tmp_path / folder / "own_law.py"
        path.parent.mkdir()
        text = f"from typing import NamedTuple\nARM = {arm}\nclass Own(NamedTuple):\n    k: float\n"
        path.write_text(text)
        spec = spec_from_file_location("own_law", path)
        module = module_from_spec(spec)
        monkeypatch.setitem(sys.modules, "own_law", module)
        spec.loader.exec_module(module)
        words.append(hash_own_records((numba.typeof(module.Own(1.0)), numba.float64)))
    assert words[0] == words[1] != words[2]
    body = Body(*[1.0] * len(Body._fields))
    assert hash_own_records((numba.typeof(body), numba.float64)) == "", "the package's own"
    held = numba.typeof(body._replace(cells=module.Own(1.0)))
    assert hash_own_records((held,)) == words[-1], "a field of a record"
