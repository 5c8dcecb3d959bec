"""All that the kernels take from inside Numba, beyond its documented interface.

Numba documents `njit`, its options, `overload`, `typeof` and its types; those are used wherever
they are needed. What stands here is not documented, and any version of Numba may change it:

* the place where a dispatcher holds its cache, and the six members of such a cache (`NumbaCache`).
  Numba's own cache can go stale where a kernel calls functions of other files, see `compiled`;
* how the result of a compilation is taken apart and put together again (`reduce_result`,
  `rebuild_result`, `can_be_kept`), and Numba's pickle for it (`dump`);
* the machine that code is made for (`describe_machine`, `get_codegen`);
* four options of `njit`: `_nrt`, `no_cpython_wrapper`, `no_cfunc_wrapper` and `forceinline`
  (`make_dispatcher`, `BORROWED_OPTIONS`);
* the library that a compiler fills, and the moment before it is optimized, at which its functions
  are closed to other files (`make_closed_compiler`);
* `compile` of a dispatcher (`compile_for`), and `instance_class` of a named tuple's type
  (`get_record_class`).

Each is looked up by a function of this module, which raises a NumbaError where it is not there.
Whether it still does what is wanted is tested in `tests/dynamics/kernels/test_numba_internals.py`.
"""

from collections.abc import Callable, Sequence
from functools import cache
from importlib import import_module
from typing import Any

import numba

from gridpush_drake.errors import NumbaError

KNOWN_NUMBA_VERSION = "0.68"
"""Version of Numba of which all this is known to be true."""

CACHE_ATTRIBUTE = "_cache"
"""Attribute of a dispatcher that holds its cache."""

CACHE_MEMBERS = frozenset(
    {"cache_path", "load_overload", "save_overload", "enable", "disable", "flush"}
)
"""Public members of a dispatcher's cache."""

NO_REFERENCES = "_nrt"
"""Option that, where it is False, keeps a function from counting references to arrays."""

NO_PYTHON = "no_cpython_wrapper"
"""Option that leaves out the form of a function that Python calls."""

NO_C = "no_cfunc_wrapper"
"""Option that leaves out the form of a function that C calls."""

INLINE_OPTION = "forceinline"
"""Option that makes a function's code part of every function that calls it.

A function for which it is not set takes it from whichever function has it compiled first."""

SHARED_LINKAGE = "linkonce_odr"
"""Linkage of a function of which each file that needs it holds a copy. Of all the copies that a
process has loaded, all callers call the one that was loaded first."""

ENTRY_LINKAGE = "external"
"""Linkage of the functions that a file is there for."""

INTERNAL_LINKAGE = "internal"
"""Linkage of a function that only its own file calls."""

RUNTIME_PREFIX = "NRT_"
"""Beginning of the names of the functions that count references. Numba's optimization knows them by
their names, and they calculate nothing."""

BORROWED_OPTIONS: Any = {NO_REFERENCES: False, INLINE_OPTION: True}
"""Options of an `overload` that passes on what its caller holds."""


class NumbaCache:
    """The methods that Numba calls of the cache of a compiled function.

    A subclass gives the folder, the reading and the writing; a cache is always on.
    """

    @property
    def cache_path(self) -> str:
        """Folder of the cache; empty where there is none."""
        raise NotImplementedError

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """Finds the result of a compilation; None where there is none."""
        raise NotImplementedError

    def save_overload(self, signature: Any, data: Any) -> None:
        """Keeps the result of a compilation."""
        raise NotImplementedError

    def enable(self) -> None:
        """Does nothing: the cache is always on."""

    def disable(self) -> None:
        """Does nothing: the cache is always on."""

    def flush(self) -> None:
        """Does nothing: every result is written at once."""


def make_dispatcher(
    function: Callable[..., Any],
    cache: NumbaCache,
    *,
    counts_references: bool,
    called_from_python: bool,
    inlined: bool = False,
    **options: Any,
) -> Callable[..., Any]:
    """Makes a function one that is compiled on its first call.

    What it calculates is the same, to the last bit, whichever process compiled it and whatever else
    was loaded before, see `make_closed_compiler`.

    Args:
        function: the function.
        cache: where what is compiled is kept.
        counts_references: whether it counts references to arrays, as one must that makes some.
        called_from_python: whether Python can call it, and not compiled code alone.
        inlined: whether its code becomes part of every function that calls it.
        options: further options of `numba.njit`, documented ones.

    Returns:
        The dispatcher.

    Raises:
        NumbaError: the installed Numba is built differently.
    """
    known = _take(_import("numba.core.cpu"), "CPUTargetOptions", "numba.core.cpu")
    for name in (NO_REFERENCES, NO_PYTHON, NO_C, INLINE_OPTION):
        _take(known, name, "numba.core.cpu.CPUTargetOptions")
    all_options: dict[str, Any] = {
        **options,
        NO_REFERENCES: counts_references,
        NO_PYTHON: not called_from_python,
        NO_C: True,
        INLINE_OPTION: inlined,
    }
    dispatcher: Any = numba.njit(pipeline_class=make_closed_compiler(), **all_options)(function)
    if dispatcher is function:
        return dispatcher  # NUMBA_DISABLE_JIT is set: nothing is compiled, nor kept
    its_own = _take(dispatcher, CACHE_ATTRIBUTE, "a dispatcher")
    members = {name for name in dir(its_own) if not name.startswith("_")}
    if members != CACHE_MEMBERS:
        raise _complain(f"a dispatcher's cache with {', '.join(sorted(CACHE_MEMBERS))} alone")
    setattr(dispatcher, CACHE_ATTRIBUTE, cache)
    return dispatcher


@cache
def make_closed_compiler() -> type:
    """Makes the class of a compiler whose machine code calls only what stands in the same file.

    Numba compiles each function into a file of its own, with a copy of every function that it
    calls; of the copies that a process has loaded, the first one is called by all. But each copy
    was optimized among other code, and where sums may be reordered (`fast_sums`), two copies can
    differ in the last bit. Results would so depend on what a process happened to load, or to
    compile, before. Here a file's copies are closed to other files before they are optimized. And
    what another kernel takes over is the code as it was before, so that there is one copy of each
    function in a file, and all of it is optimized together.

    Returns:
        A subclass of Numba's compiler, for `njit(pipeline_class=...)`.
    """
    codegen = _import("numba.core.codegen")
    library_class: Any = _take(codegen, "JITCodeLibrary", "numba.core.codegen")
    compiler_class: Any = _take(_import("numba.core.compiler"), "Compiler", "numba.core.compiler")
    for name in ("_optimize_final_module", "_get_module_for_linking", "enable_object_caching"):
        _take(library_class, name, "numba.core.codegen.JITCodeLibrary")
    _take(compiler_class, "compile_extra", "numba.core.compiler.Compiler")

    class ClosedLibrary(library_class):
        """The code of one function and of all that it calls."""

        def _optimize_final_module(self) -> None:
            """Closes the functions before they are optimized, and keeps them open for linking."""
            self._shared_module = self._final_module.clone()
            _change_linkage(self._shared_module, ENTRY_LINKAGE, SHARED_LINKAGE)
            _change_linkage(self._final_module, SHARED_LINKAGE, INTERNAL_LINKAGE)
            super()._optimize_final_module()

    class ClosedCompiler(compiler_class):
        """A compiler that fills such a library."""

        def compile_extra(self, func: Callable[..., Any]) -> Any:
            """Compiles a function."""
            library = ClosedLibrary(self.state.targetctx.codegen(), func.__qualname__)
            library.enable_object_caching()
            self.state.library = library
            return super().compile_extra(func)

    return ClosedCompiler


def _change_linkage(module: Any, old: str, new: str) -> None:
    """Gives the functions of an LLVM module that have one linkage another one."""
    for function in module.functions:
        is_runtime = function.name.startswith(RUNTIME_PREFIX)
        if not (function.is_declaration or is_runtime) and function.linkage.name == old:
            function.linkage = new


def get_cache(dispatcher: Any) -> Any:
    """Takes the cache of a dispatcher."""
    return _take(dispatcher, CACHE_ATTRIBUTE, "a dispatcher")


def compile_for(dispatcher: Any, types: Sequence[Any]) -> None:
    """Compiles a function for some types of arguments, or finds it in its cache."""
    _take(dispatcher, "compile", "a dispatcher")(tuple(types))


def get_codegen(target_context: Any) -> Any:
    """Takes the maker of machine code from a target context, once that knows all it should."""
    _take(target_context, "refresh", "a target context")()
    return _take(target_context, "codegen", "a target context")()


def describe_machine(codegen: Any) -> list[str]:
    """Says which machine code is made for: its kind, the processor's name and its features."""
    return [str(part) for part in _take(codegen, "magic_tuple", "a code generator")()]


def get_result_codegen(result: Any) -> Any:
    """Takes the maker of machine code that made the result of a compilation."""
    return _take(result, "codegen", "a compilation's result")


def can_be_kept(result: Any) -> bool:
    """Whether the result of a compilation holds for other processes, too.

    One with loops that were compiled by themselves does not, nor one that holds addresses.
    """
    loops = _take(result, "lifted", "a compilation's result")
    library = _take(result, "library", "a compilation's result")
    holds_addresses = _take(library, "has_dynamic_globals", "a compiled library")
    return not holds_addresses and all(loop.can_cache for loop in loops)


def reduce_result(result: Any) -> Any:
    """Takes the result of a compilation apart, into what `dump` can write."""
    return _take(result, "_reduce", "a compilation's result")()


def rebuild_result(target_context: Any, reduced: Any) -> Any:
    """Puts the result of a compilation together again."""
    kind = _take(_import("numba.core.compiler"), "CompileResult", "numba.core.compiler")
    return _take(kind, "_rebuild", "numba.core.compiler.CompileResult")(target_context, *reduced)


def dump(value: Any) -> bytes:
    """Pickles values and functions by value; the standard library's `pickle.loads` reads them."""
    pickled: bytes = _take(_import("numba.core.serialize"), "dumps", "numba.core.serialize")(value)
    return pickled


def get_record_class(numba_type: Any) -> type | None:
    """Finds the class of a named tuple from its type in Numba; None of another type."""
    # Numba has a type of its own for a named tuple whose fields are all of one type.
    if not isinstance(numba_type, numba.types.NamedTuple | numba.types.NamedUniTuple):
        return None
    found: type = _take(numba_type, "instance_class", "the type of a named tuple")
    return found


def list_record_classes(numba_types: Sequence[Any]) -> set[type]:
    """Lists the classes of the named tuples among types in Numba, and of those that these hold."""
    found = set()
    for each in numba_types:
        record = get_record_class(each)
        if record is not None:
            found |= {record, *list_record_classes(tuple(each))}
    return found


def _import(name: str) -> Any:
    """Imports one of Numba's modules."""
    try:
        return import_module(name)
    except ImportError as error:
        raise _complain(f"module {name}") from error


def _take(owner: Any, name: str, what: str) -> Any:
    """Takes an attribute from something of Numba's, which `what` calls by name."""
    try:
        return getattr(owner, name)
    except AttributeError as error:
        raise _complain(f"attribute {name} of {what}") from error


def _complain(missing: str) -> NumbaError:
    """Makes the error that says what this version of Numba lacks."""
    return NumbaError(
        f"Numba {numba.__version__} has no {missing}, which the compiled kernels need; "
        f"expected another version: pip install 'numba=={KNOWN_NUMBA_VERSION}.*'"
    )
