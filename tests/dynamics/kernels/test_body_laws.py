"""The laws of several bodies in one record: a kernel gets of each what its author made."""

from typing import Any, NamedTuple

import numba
import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.scene.body_laws import copy_laws, join_laws, take_law

SHARED = np.array([5.0])
"""What all bodies have in common."""


class Part(NamedTuple):
    """A record within a law."""

    table: Any
    shared: Any


class Law(NamedTuple):
    """Arrays of all kinds and numbers, as a law's author may want them."""

    k: Any
    count: int
    scale: float
    part: Part
    cube: Any


class Bodies(NamedTuple):
    """What `take_law` asks of bodies."""

    laws: Any
    law_places: Any
    first_cell: Any
    cells: Any


def make_law(n):
    """The law of a body of n cells."""
    part = Part(table=np.arange(2.0 * n).reshape(2, n), shared=SHARED)
    return Law(np.arange(n) + 0.5, n, 0.1 * n, part, np.arange(3.0 * n).reshape(n, 1, 3))


@kernel(allocates=False)
def read_law(bodies, b, out):
    """Reads something of every field, and writes where the law remembers something."""
    law, cells = take_law(bodies, b)
    n = law.count
    out[0] = law.k.shape[0] + law.k[n - 1] + law.scale
    out[1] = law.part.table.shape[1] + law.part.table[1, n - 1]
    out[2] = law.part.shared[0]
    out[3] = law.cube.shape[0] + law.cube[n - 1, 0, 2]
    out[4] = cells[0, 0] + 100.0 * cells[1, n - 1]
    law.k[0] = -1.0


def test_a_kernel_gets_the_law_of_each_body():
    sizes = [4, 2, 3]
    laws = [make_law(n) for n in sizes]
    entries, places = join_laws(laws, make_law(sizes[0]))
    first = np.append(0, np.cumsum(sizes))
    bodies = Bodies(copy_laws(entries), places, first, np.arange(2.0 * first[-1]))
    for b, n in enumerate(sizes):
        out = np.empty(5)
        read_law(bodies, b, out)
        begin = 2 * first[b]
        expected = [n + n - 0.5 + 0.1 * n, n + 2 * n - 1, 5.0, n + 3 * n - 1]
        np.testing.assert_allclose(out, [*expected, begin + 100.0 * (begin + 2 * n - 1)])
    # each remembers for itself, and in the copy alone
    np.testing.assert_array_equal(bodies.laws.k[first[:-1]], -1.0)
    np.testing.assert_array_equal(entries.k, np.concatenate([law.k for law in laws]))
    assert entries.part.shared is SHARED
    # the record of one body has the same form, so that nothing is compiled anew for it
    one, where = join_laws([make_law(2)], make_law(2))
    assert numba.typeof((one, where)) == numba.typeof((entries, places))
