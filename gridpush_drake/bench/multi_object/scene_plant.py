"""Rows of objects that a bench pushes through each other, in Drake's MultibodyPlant.

Every object has the planar base: each cell stands on a sphere that bears its own weight, as the
scene model assumes. The sides of two objects touch each other, and the pusher's tip, by boxes along
and within the outlines.
"""

from collections.abc import Callable

import numpy as np
from pydrake.geometry import (
    Box,
    CollisionFilterDeclaration,
    GeometrySet,
    ProximityProperties,
    RoleAssign,
)
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.bench.multi_object.scene_rows import PAIR_FRICTION, PUSHER_FRICTION
from gridpush_drake.bench.worlds.plant import (
    PUSH_HEIGHT,
    STICTION_TOLERANCE,
    TABLE_SIZE,
    TIME_STEP,
    AddPusher,
)
from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.push import Push
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.contact_material import (
    PARTNER_STIFFNESS,
    MakeContactProperties,
    MakePartnerProperties,
)
from gridpush_drake.multibody.grid_object import AddGridObject
from gridpush_drake.multibody.ground_truth import CalcPlanarPose, SetGridObjectPose
from gridpush_drake.multibody.parser import AddPlantAndSceneGraph


def MakePlantScene(bodies: Bodies, poses: Array, push: Push) -> Callable[[Array], Array]:
    """Prepares a push of objects at poses (N, 3), m and rad, in a MultibodyPlant.

    Drake combines two frictions mu_a and mu_b into 2 mu_a mu_b / (mu_a + mu_b), which is mu where
    both are mu: so all sides have `PAIR_FRICTION`, and the pusher's tip what makes
    `PUSHER_FRICTION` of it.

    Returns:
        A function that runs it once from the beginning and returns the poses (K, N, 3), m and rad,
        at increasing times (K,) of the push, s.
    """
    dt = TIME_STEP["planar"]
    builder = DiagramBuilder()
    plant, scene_graph = AddPlantAndSceneGraph(builder, dt)
    plant.set_stiction_tolerance(STICTION_TOLERANCE)
    table = plant.RegisterCollisionGeometry(
        plant.world_body(),
        RigidTransform(np.array([0.0, 0.0, -TABLE_SIZE[2] / 2])),
        Box(*TABLE_SIZE),
        "table",
        MakePartnerProperties(),
    )
    pusher = AddPusher(plant, push.radius, PUSH_HEIGHT)
    tip = plant.GetCollisionGeometriesForBody(plant.GetBodyByName("tip", pusher))
    handles = [
        AddGridObject(
            plant, scene_graph, Model(obj, params), table=[table], name=f"object_{b}", visual=False
        )
        for b, (obj, params) in enumerate(bodies)
    ]
    # Sides and tip rub as is wanted.
    source = plant.get_source_id()
    for handle in handles:
        for side in handle.sides:
            properties = ProximityProperties(
                scene_graph.model_inspector().GetProximityProperties(side)
            )
            wanted = MakeContactProperties(PAIR_FRICTION, handle.side_stiffness)
            friction = wanted.GetProperty("material", "coulomb_friction")
            properties.UpdateProperty("material", "coulomb_friction", friction)
            scene_graph.AssignRole(source, side, properties, RoleAssign.kReplace)
    own = PUSHER_FRICTION * PAIR_FRICTION / (2 * PAIR_FRICTION - PUSHER_FRICTION)
    for geometry in tip:
        properties = MakeContactProperties(own, PARTNER_STIFFNESS)
        scene_graph.AssignRole(source, geometry, properties, RoleAssign.kReplace)
    # The tip may be low, and must not rub on the table; spheres touch the table alone.
    declaration = CollisionFilterDeclaration()
    declaration.ExcludeBetween(GeometrySet(tip), GeometrySet(table))
    spheres = [sphere for handle in handles for sphere in handle.contact_spheres]
    sides = [side for handle in handles for side in handle.sides]
    declaration.ExcludeBetween(GeometrySet(spheres), GeometrySet([*sides, *tip]))
    declaration.ExcludeWithin(GeometrySet(spheres))
    scene_graph.collision_filter_manager().Apply(declaration)
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = simulator.get_mutable_context()
    plant_context = plant.GetMyMutableContextFromRoot(context)
    for handle, pose in zip(handles, poses, strict=True):
        SetGridObjectPose(plant, plant_context, handle, pose)
    steps = round(push.duration / dt)
    times = np.linspace(0.0, push.duration, steps + 1)
    path = push.tip_at(times)
    velocity = np.gradient(path, times, axis=0)
    desired = plant.get_desired_state_input_port(pusher)
    plant.SetPositions(plant_context, pusher, path[0])
    plant.SetVelocities(plant_context, pusher, velocity[0])
    desired.FixValue(plant_context, np.r_[path[0], velocity[0]])
    simulator.Initialize()

    def run(wanted: Array) -> Array:
        rows = np.rint(np.asarray(wanted) / dt).astype(int)
        seen = []
        for i in range(steps + 1):
            if i > 0:
                # the gains act at the step's end, so that is where the pusher is wanted
                desired.FixValue(plant_context, np.r_[path[i], velocity[i]])
                simulator.AdvanceTo(i * dt)
            for _ in range(np.count_nonzero(rows == i)):
                seen.append([CalcPlanarPose(plant, plant_context, handle) for handle in handles])
        return np.array(seen)

    return run
