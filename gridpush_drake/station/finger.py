"""The friction of the finger's tip, replaced after the model was parsed."""

from pydrake.geometry import ProximityProperties, RoleAssign, SceneGraph
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from gridpush_drake.errors import StationError

TIP_BODY = "finger_tip"
"""Name of the body that is the sphere; whatever else touches the object or the table is at fault."""


def SetTipFriction(plant: MultibodyPlant, scene_graph: SceneGraph, finger: ModelInstanceIndex, friction: float) -> None:
    """Gives the finger's tip a Coulomb friction. Call it before a Context is made.

    Drake combines two frictions a and b as 2 a b / (a + b): where both are mu, the contact has mu.

    Args:
        plant: has the finger.
        scene_graph: the plant's.
        finger: the finger's model instance.
        friction: coefficient, static and dynamic.

    Raises:
        StationError: the coefficient is negative.
    """
    if not friction >= 0.0:
        raise StationError(f"friction of the tip is {friction!r}; expected a number of 0 or more")
    inspector, source = scene_graph.model_inspector(), plant.get_source_id()
    for geometry in plant.GetCollisionGeometriesForBody(plant.GetBodyByName(TIP_BODY, finger)):
        properties = ProximityProperties(inspector.GetProximityProperties(geometry))
        properties.UpdateProperty("material", "coulomb_friction", CoulombFriction(friction, friction))
        scene_graph.AssignRole(source, geometry, properties, RoleAssign.kReplace)
