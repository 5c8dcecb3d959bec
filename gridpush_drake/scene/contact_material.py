"""Contact properties, with Drake's combination laws undone.

Two surfaces a and b touch with friction 2 mu_a mu_b/(mu_a + mu_b) and stiffness k_a k_b/(k_a + k_b). Against a *stiff
partner* of friction mu_b = 1 and stiffness k_b >> k_a, the contact has friction mu and stiffness k_a where

    mu_a = mu mu_b / (2 mu_b - mu) = mu / (2 - mu)

So whatever touches a grid object (the table under its feet, the pusher's tip at its side) is made a stiff partner, and
the object alone carries the parameters of the contact.
"""

from collections.abc import Iterable

from pydrake.geometry import GeometryId, ProximityProperties, RoleAssign, SceneGraph
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant

from gridpush_drake.errors import ParameterError

PARTNER_FRICTION = 1.0
"""Coefficient of a stiff partner."""

PARTNER_STIFFNESS = 1e12
"""N/m, of a stiff partner: next to it every foot's stiffness is its contact's to 1e-6."""


def calc_own_friction(friction: float, name: str = "friction") -> float:
    """Finds the coefficient that gives a contact with a stiff partner the wanted friction.

    Args:
        friction: wanted coefficient of the contact, 0 <= mu < 2.
        name: of the value, for the message.

    Returns:
        mu / (2 - mu).

    Raises:
        ParameterError: no coefficient gives that much.
    """
    limit = 2 * PARTNER_FRICTION
    if not 0 <= friction < limit:
        raise ParameterError(f"{name} is {friction:g}; expected at least 0 and less than {limit:g} in a Drake plant")
    return friction * PARTNER_FRICTION / (limit - friction)


def MakeContactProperties(friction: float, stiffness: float, dissipation: float = 0.0) -> ProximityProperties:
    """Makes the properties of a surface.

    Args:
        friction: its own coefficient, static and dynamic.
        stiffness: of its point contacts, N/m.
        dissipation: Hunt-Crossley, s/m.

    Returns:
        New properties.
    """
    properties = ProximityProperties()
    properties.AddProperty("material", "coulomb_friction", CoulombFriction(friction, friction))
    properties.AddProperty("material", "point_contact_stiffness", float(stiffness))
    properties.AddProperty("material", "hunt_crossley_dissipation", float(dissipation))
    return properties


def MakePartnerProperties() -> ProximityProperties:
    """Makes the properties of a stiff partner."""
    return MakeContactProperties(PARTNER_FRICTION, PARTNER_STIFFNESS)


def SetPartner(plant: MultibodyPlant, scene_graph: SceneGraph, geometries: Iterable[GeometryId]) -> None:
    """Makes stiff partners of collision geometries that are there already: the table's, the pusher's tip.

    Args:
        plant: whose geometries they are; before a Context is made.
        scene_graph: where they are registered.
        geometries: collision geometries of the plant.
    """
    source = plant.get_source_id()
    for geometry in geometries:
        # keep what else is known of the surface, such as its hydroelastic properties
        properties = ProximityProperties(scene_graph.model_inspector().GetProximityProperties(geometry))
        wanted = MakePartnerProperties()
        for name in wanted.GetPropertiesInGroup("material"):
            properties.UpdateProperty("material", name, wanted.GetProperty("material", name))
        scene_graph.AssignRole(source, geometry, properties, RoleAssign.kReplace)
