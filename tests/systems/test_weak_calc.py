"""Every system is freed when it is dropped, with the Diagram that it is in."""

import gc
from weakref import ref

import pytest
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from tests.systems.test_not_a_number import SYSTEMS


@pytest.mark.parametrize("name", SYSTEMS)
def test_is_freed(name):
    builder = DiagramBuilder()
    system = builder.AddSystem(SYSTEMS[name]())
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    kept = [ref(system), ref(diagram)]
    del builder, diagram, context
    gc.collect()
    assert kept[1]() is not None, "a system keeps its Diagram"
    assert isinstance(system, LeafSystem)
    del system
    gc.collect()
    assert [one() for one in kept] == [None, None]
