"""Worlds by their names: what moves the objects of a bench, one of ours or a reader's own.

A job holds a world's name and not the class, so that it can be sent to a worker process and written
to a file of results.
"""

from importlib import import_module

from gridpush_drake.errors import GridPushError
from gridpush_drake.planning.world import WorldMaker

LCP_WORLD = "lcp"
"""Name of the model's own simulator, in which loads do not shift at an edge."""

EDGE_WORLD = "edge"
"""Name of the model's own simulator, in which loads shift at the table's edge."""

MUJOCO_WORLD = "mujoco"
"""Name of the rigid body in MuJoCo, on feet."""

DRAKE_WORLD = "drake"
"""Name of the body in Drake's MultibodyPlant."""

WORLD_CLASSES = {
    LCP_WORLD: "gridpush_drake.planning.world:SimulatedWorld",
    EDGE_WORLD: "gridpush_drake.bench.pregrasp.world:EdgeWorld",
    MUJOCO_WORLD: "gridpush_drake.bench.pregrasp.world:MujocoEdgeWorld",
    DRAKE_WORLD: "gridpush_drake.bench.worlds.plant:PlantWorld",
}
"""Modules and classes of this package's worlds, by name."""

OWN_WORLD_FORM = "MODULE:CLASS of a world of your own"
"""How a world is named that is not one of WORLD_CLASSES."""


def find_world(name: str) -> WorldMaker:
    """Finds a world by its name.

    Args:
        name: one of WORLD_CLASSES, or MODULE:CLASS of a class that is made as `WorldMaker` says.
            The module must be importable, in worker processes too.

    Raises:
        GridPushError: there is no such world.
    """
    expected = f"expected one of {', '.join(WORLD_CLASSES)}, or {OWN_WORLD_FORM}"
    module, colon, attribute = WORLD_CLASSES.get(name, name).partition(":")
    if not (module and colon and attribute):
        raise GridPushError(f"world: {name!r}; {expected}")
    try:
        found: WorldMaker = getattr(import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise GridPushError(f"world: {name!r} ({error}); {expected}") from error
    return found
