"""Every system is freed when it is dropped, with the Diagram that it is in."""

import gc
from weakref import ref

from pydrake.systems.framework import DiagramBuilder, LeafSystem

from tests.systems.test_not_a_number import SYSTEMS


def make_system(name):
    """A system that has been in use in a Diagram, and weak references to both."""
    builder = DiagramBuilder()
    system = builder.AddSystem(SYSTEMS[name]())
    diagram = builder.Build()
    diagram.CreateDefaultContext()
    return system, ref(system), ref(diagram)


def test_all_are_freed():
    made = {name: make_system(name) for name in SYSTEMS}
    gc.collect()
    assert all(diagram() is not None for *_, diagram in made.values()), "each keeps its Diagram"
    assert all(isinstance(system, LeafSystem) for system, *_ in made.values())
    kept = {name: references for name, (_, *references) in made.items()}
    del made
    gc.collect()
    assert [name for name, both in kept.items() if any(one() is not None for one in both)] == []
