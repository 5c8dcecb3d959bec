"""A plant that is dropped gives its memory back."""

import ctypes
import gc
import os
import sys
from pathlib import Path

import pytest
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.multibody.parser import AddPlantAndSceneGraph

COUNT = 40
"""Number of Diagrams that are made and dropped."""

MOST_KEPT = 30e3
"""Most memory that one of them may leave behind, on average, bytes. With Drake's own function it is
about 100e3."""


def make_diagram(add=AddPlantAndSceneGraph):
    builder = DiagramBuilder()
    plant, _ = add(builder, 0.001)
    plant.Finalize()
    return builder.Build()


def measure_memory():
    """What the process holds, bytes, when all that was dropped is given back."""
    gc.collect()
    ctypes.CDLL("libc.so.6").malloc_trim(0)
    return os.sysconf("SC_PAGE_SIZE") * int(Path("/proc/self/statm").read_text().split()[1])


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is measured on Linux only")
def test_a_diagram_that_is_dropped_gives_its_memory_back():
    for _ in range(10):
        make_diagram()
    before = measure_memory()
    for _ in range(COUNT):
        make_diagram()
    kept = (measure_memory() - before) / COUNT
    print(f"{kept / 1e3:.1f} kB a Diagram")
    assert kept < MOST_KEPT


def test_plant_and_scene_graph_are_named_and_connected_as_by_drake():
    ours, drakes = make_diagram(), make_diagram(AddMultibodyPlantSceneGraph)
    described = [
        (
            [system.get_name() for system in diagram.GetSystems()],
            {
                (to.get_name(), to.get_input_port(i).get_name()): (
                    source.get_name(),
                    source.get_output_port(j).get_name(),
                )
                for (to, i), (source, j) in diagram.connection_map().items()
            },
        )
        for diagram in (ours, drakes)
    ]
    assert described[0] == described[1]
