"""What the kernels take from inside Numba is there, does what is wanted, and its absence is named."""

import os
import pickle
import re
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core import codegen, compiler, cpu, serialize

from gridpush_drake.dynamics.kernels import numba_internals
from gridpush_drake.dynamics.kernels.contact.contact import Edges
from gridpush_drake.dynamics.kernels.forward_sensitivity import Columns
from gridpush_drake.dynamics.kernels.numba_internals import NumbaCache, make_dispatcher
from gridpush_drake.errors import NumbaError


class Memory(NumbaCache):
    """A cache that holds what was compiled, taken apart and pickled, in this process."""

    def __init__(self):
        self.kept = {}

    @property
    def cache_path(self):
        return ""

    def load_overload(self, signature, target_context):
        numba_internals.get_codegen(target_context)
        pickled = self.kept.get(str(signature))
        if pickled is None:
            return None
        return numba_internals.rebuild_result(target_context, pickle.loads(pickled))

    def save_overload(self, signature, data):
        assert numba_internals.can_be_kept(data)
        assert numba_internals.get_result_codegen(data) is not None
        self.kept[str(signature)] = numba_internals.dump(numba_internals.reduce_result(data))


def first_of_copy(x):
    y = x.copy()
    return y[0]


def first(x):
    return x[0]


def compile_text(function, *, counts_references=True, called_from_python=True):
    """The LLVM code of a function that takes an array."""
    made = make_dispatcher(
        function,
        Memory(),
        counts_references=counts_references,
        called_from_python=called_from_python,
    )
    numba_internals.compile_for(made, (numba.float64[::1],))
    return "".join(made.inspect_llvm().values())


def test_a_dispatcher_asks_its_cache_and_runs_what_the_cache_gives_it():
    cache = Memory()
    options = {"counts_references": True, "called_from_python": True}
    one = make_dispatcher(first_of_copy, cache, **options)
    other = make_dispatcher(first_of_copy, cache, **options)
    assert one(np.array([2.0, 3.0])) == 2.0
    assert len(cache.kept) == 1
    assert other(np.array([4.0, 3.0])) == 4.0
    assert sum(other.stats.cache_hits.values()) == 1, "compiled anew instead"
    assert numba_internals.get_cache(other) is cache


def test_a_function_that_borrows_its_arrays_does_not_count_references():
    assert "NRT_decref" in compile_text(first_of_copy)
    text = compile_text(first, counts_references=False)
    assert "NRT_incref" not in text and "NRT_decref" not in text


def test_the_forms_for_python_and_for_c_are_left_out():
    assert "@_ZN7cpython" in compile_text(first)
    text = compile_text(first, called_from_python=False)
    assert "cpython" not in text and "cfunc" not in text
    assert "cfunc" not in compile_text(first)


def list_closed_and_shared(caller):
    """The functions in a caller's machine code that are its own alone, and those that may be another one's."""
    caller(np.ones(8))
    (text,) = caller.inspect_llvm().values()
    definitions = re.findall(r"^define (internal|linkonce_odr) .*@(\S+?)\(", text, re.MULTILINE)
    names = {
        linkage: {name for kind, name in definitions if kind == linkage}
        for linkage, _ in definitions
    }
    closed, shared = names.get("internal", set()), names.get("linkonce_odr", set())
    return closed, {name for name in shared if not name.startswith(numba_internals.RUNTIME_PREFIX)}


@pytest.mark.parametrize("loaded", [False, True])
def test_a_kernel_calls_its_own_copies_of_other_kernels_whatever_was_loaded_before(loaded):
    def sum_terms(x):
        total = 0.0
        for value in x:
            for k in range(1, 9):
                total += (
                    np.sin(k * value) * np.exp(-value) / (1 + np.cosh(value) + np.arctan(k + value))
                )
        return total

    def sum_twice(x):
        return sum_terms(x) + sum_terms(x[::-1].copy()) * sum_terms(x + 1.0)

    options = {"counts_references": True, "called_from_python": True}
    plain, memory = sum_terms, Memory()
    sum_terms = numba.njit(plain)
    _, shared = list_closed_and_shared(numba.njit(sum_twice))
    assert any("sum_terms" in name for name in shared), "what is to be prevented does not happen"
    sum_terms = make_dispatcher(plain, memory, fastmath={"reassoc"}, **options)
    if loaded:
        sum_terms(np.ones(8))
        sum_terms = make_dispatcher(plain, memory, fastmath={"reassoc"}, **options)
    closed, shared = list_closed_and_shared(make_dispatcher(sum_twice, Memory(), **options))
    assert any("sum_terms" in name for name in closed) and not shared
    assert sum(sum_terms.stats.cache_hits.values()) == loaded


def test_the_machine_is_described_by_its_kind_its_processor_and_its_features():
    made = make_dispatcher(first, Memory(), counts_references=True, called_from_python=True)
    codegen = numba_internals.get_codegen(made.targetctx)
    kind, processor, features = numba_internals.describe_machine(codegen)
    assert "-" in kind and processor
    assert "+" in features or "-" in features


def test_what_holds_an_address_is_not_kept():
    class Library:
        has_dynamic_globals = True

    class Result:
        lifted = ()
        library = Library()

    assert not numba_internals.can_be_kept(Result())


def test_the_class_of_a_named_tuple_is_found():
    edges = Edges(*[np.zeros(1)] * 4, np.zeros(1, np.int64))
    assert numba_internals.get_record_class(numba.typeof(edges)) is Edges
    alike = Columns(*[np.zeros((1, 1))] * len(Columns._fields))
    assert numba_internals.get_record_class(numba.typeof(alike)) is Columns
    assert numba_internals.get_record_class(numba.float64) is None


def make():
    return make_dispatcher(first, Memory(), counts_references=True, called_from_python=True)


def make_closed_compiler():
    return numba_internals.make_closed_compiler.__wrapped__()


@pytest.mark.parametrize(
    ("owner", "name", "call"),
    [
        (cpu.CPUTargetOptions, "_nrt", make),
        (cpu.CPUTargetOptions, "no_cpython_wrapper", make),
        (codegen, "JITCodeLibrary", make_closed_compiler),
        (codegen.JITCodeLibrary, "_optimize_final_module", make_closed_compiler),
        (compiler, "Compiler", make_closed_compiler),
        (compiler, "CompileResult", lambda: numba_internals.rebuild_result(None, ())),
        (serialize, "dumps", lambda: numba_internals.dump(1)),
    ],
)
def test_what_a_version_of_numba_lacks_is_named(monkeypatch, owner, name, call):
    if isinstance(owner, type):
        for base in owner.__mro__:
            if name in vars(base):
                monkeypatch.delattr(base, name)
    else:
        monkeypatch.delattr(owner, name)
    with pytest.raises(NumbaError) as caught:
        call()
    message = str(caught.value)
    assert message.startswith(f"Numba {numba.__version__} has no attribute {name} of numba.core.")
    assert message.endswith(f"pip install 'numba=={numba_internals.KNOWN_NUMBA_VERSION}.*'")


class Empty:
    """Something of Numba's that lost what is taken from it."""


@pytest.mark.parametrize(
    "call",
    [
        numba_internals.get_cache,
        lambda value: numba_internals.compile_for(value, ()),
        numba_internals.get_codegen,
        numba_internals.describe_machine,
        numba_internals.get_result_codegen,
        numba_internals.can_be_kept,
        numba_internals.reduce_result,
    ],
)
def test_a_part_that_lost_what_is_taken_from_it_is_named(call):
    with pytest.raises(NumbaError, match="which the compiled kernels need"):
        call(Empty())


def test_a_cache_with_another_interface_is_refused(monkeypatch):
    monkeypatch.setattr(numba_internals, "CACHE_MEMBERS", numba_internals.CACHE_MEMBERS - {"flush"})
    with pytest.raises(NumbaError, match="a dispatcher's cache with cache_path, disable"):
        make()


COMMAND = """
import sys
from numba.core import cpu
for base in cpu.CPUTargetOptions.__mro__:
    if "_nrt" in vars(base):
        delattr(base, "_nrt")
from gridpush_drake.cli.main import main
sys.argv = ["gridpush", "simulate", "pliers"]
main()
"""


def test_a_command_says_in_one_line_that_numba_is_another_one():
    done = subprocess.run(
        [sys.executable, "-c", COMMAND],
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[3],
        env=os.environ,
        check=False,
    )
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert "has no attribute _nrt" in done.stderr
