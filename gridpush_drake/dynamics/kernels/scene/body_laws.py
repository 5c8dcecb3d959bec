"""The friction laws of several bodies in one record, from which a kernel takes that of each.

A law's data are a named tuple of arrays and numbers, whatever its author put there. So those of N
bodies are stored in a record of the same class, of which each field holds the entries of all
bodies one after another. Beside it stands another record of that class, which says where each
body's entries begin, and in which shape they are. `take_law` puts the law of one body together
again: its arrays are views, so that a law may remember something in them, and the laws' functions
are called as for one body.

What all bodies have in common (the very same array or record) is stored once, as it is.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.numba_internals import BORROWED_OPTIONS, get_record_class
from gridpush_drake.errors import SimulationError

BEGIN, END, SHAPE = range(3)
"""Columns of a field's places: the first entry of a body, the one after its last, and from the
third column on the array's shape."""

MAX_DIMENSIONS = 3
"""Most dimensions of an array in a law's data."""


def join_laws(parts: Sequence[Any], again: Any) -> tuple[Any, Any]:
    """Joins the laws of N bodies, or fields of them.

    Args:
        parts: (N,) the laws' data, of one class.
        again: the first of them, made once more; it shows what the law has in common for all
            bodies, even where there is one.

    Returns:
        The entries of all bodies, and their places; each a record of the laws' class.

    Raises:
        SimulationError: an array has more than `MAX_DIMENSIONS` dimensions.
    """
    first = parts[0]
    if isinstance(first, tuple | np.ndarray) and all(part is again for part in parts):
        return first, None
    if isinstance(first, tuple):
        fields = [join_laws(*each) for each in zip(zip(*parts, strict=True), again, strict=True)]
        kind = type(first)
        return kind(*[field[0] for field in fields]), kind(*[field[1] for field in fields])
    if not isinstance(first, np.ndarray):
        return np.array(parts), np.arange(len(parts))
    if first.ndim > MAX_DIMENSIONS:
        raise SimulationError(
            f"friction law: an array of {first.ndim} dimensions; expected {MAX_DIMENSIONS} or "
            "fewer, for several objects"
        )
    entries = np.concatenate([part.ravel() for part in parts])
    places = []
    begin = 0
    for part in parts:
        end = begin + part.size
        places.append([begin, end, *part.shape, *[1] * (MAX_DIMENSIONS - part.ndim)])
        begin = end
    # as many dimensions as each array has, which tells the compiler how to shape them
    return entries.reshape(*[1] * (first.ndim - 1), -1), np.array(places)


def copy_laws(entries: Any) -> Any:
    """Copies the entries of all bodies, for a simulation in which laws remember something."""
    if isinstance(entries, tuple):
        return type(entries)(*[copy_laws(field) for field in entries])
    return entries.copy() if isinstance(entries, np.ndarray) else entries


@kernel(allocates=False, inlined=True)
def take_law(bodies, b):
    """Takes the law of body b, and the centers (2, n) of its cells, m.

    They are views that nobody counts: it is for kernels that do not allocate alone.
    """
    first = bodies.first_cell[b]
    last = bodies.first_cell[b + 1]
    cells = bodies.cells[2 * first : 2 * last].reshape((2, last - first))
    return _take(bodies.laws, bodies.law_places, b)[0], cells


def _take(entries, places, b):
    """Takes what a field holds of body b, in a tuple of its own; compiled code only."""
    raise NotImplementedError


def _take_all(entries, places, b):
    """Takes what each field of a tuple holds of body b; compiled code only."""
    raise NotImplementedError


@overload(_take, jit_options=BORROWED_OPTIONS)
def _take_field(entries, places, b):
    if isinstance(places, types.NoneType):
        return lambda entries, places, b: (entries,)
    record = get_record_class(entries)
    if record is not None:
        return lambda entries, places, b: (record(*_take_all(entries, places, b)),)
    if places.ndim == 1:
        return lambda entries, places, b: (entries[places[b]],)
    if entries.ndim == 1:
        return lambda entries, places, b: (entries[places[b, BEGIN] : places[b, END]],)
    if entries.ndim == 2:
        return lambda entries, places, b: (
            entries[0, places[b, BEGIN] : places[b, END]].reshape(
                (places[b, SHAPE], places[b, SHAPE + 1])
            ),
        )
    return lambda entries, places, b: (
        entries[0, 0, places[b, BEGIN] : places[b, END]].reshape(
            (places[b, SHAPE], places[b, SHAPE + 1], places[b, SHAPE + 2])
        ),
    )


@overload(_take_all, jit_options=BORROWED_OPTIONS)
def _take_all_fields(entries, places, b):
    if len(entries) == 1:
        return lambda entries, places, b: _take(entries[0], places[0], b)
    return lambda entries, places, b: (
        _take(entries[0], places[0], b) + _take_all(entries[1:], places[1:], b)
    )
