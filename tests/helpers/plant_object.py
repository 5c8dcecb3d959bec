"""A grid object on a table in a Drake plant."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.geometry import Box, GeometryId, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.contact_material import MakePartnerProperties
from gridpush_drake.multibody.grid_object import AddGridObject, GridObjectInPlant
from gridpush_drake.multibody.ground_truth import CalcPlanarPose
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

TIME_STEP = {"planar": 1e-3, "free": 2e-3}


@dataclass
class Scene:
    """A finished Diagram with one object on a table."""

    plant: MultibodyPlant
    scene_graph: SceneGraph
    handle: GridObjectInPlant
    table: GeometryId
    diagram: Diagram
    simulator: Simulator

    @property
    def context(self) -> Context:
        return self.simulator.get_mutable_context()

    @property
    def plant_context(self) -> Context:
        return self.plant.GetMyMutableContextFromRoot(self.context)

    def pose(self) -> np.ndarray:
        return CalcPlanarPose(self.plant, self.plant_context, self.handle)

    def tilt(self) -> float:
        R = self.plant.EvalBodyPoseInWorld(self.plant_context, self.handle.body).rotation().matrix()
        return float(np.arccos(np.clip(R[2, 2], -1, 1)))

    def sphere_forces(self) -> np.ndarray:
        """(f, 3) force of the table on each sphere, N; zero where a sphere does not touch."""
        results = self.plant.get_contact_results_output_port().Eval(self.plant_context)
        forces = np.zeros((len(self.handle.contact_spheres), 3))
        at = {geometry: i for i, geometry in enumerate(self.handle.contact_spheres)}
        for i in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(i)
            pair = info.point_pair()
            # the contact's force acts on body B
            if pair.id_A in at:
                forces[at[pair.id_A]] -= info.contact_force()
            elif pair.id_B in at:
                forces[at[pair.id_B]] += info.contact_force()
        return forces


def add_table(
    plant: MultibodyPlant, size: tuple[float, float] = (4.0, 4.0), x: float = 0.0
) -> GeometryId:
    """A table of `size` whose middle is at (x, 0), top at z = 0."""
    return plant.RegisterCollisionGeometry(
        plant.world_body(),
        RigidTransform([x, 0, -0.05]),
        Box(*size, 0.1),
        "table",
        MakePartnerProperties(),
    )


def make_scene(
    obj: GridObject, params: CellParameters, base: str = "planar", *, dt: float | None = None, table_x: float = 0.0,
    before_object: Any = None, after_object: Any = None, **options: Any,
) -> Scene:  # fmt: skip
    """Builds the Diagram; `before_object(plant)` and `after_object(plant, scene_graph, handle, table)` may add more."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, TIME_STEP[base] if dt is None else dt)
    table = add_table(plant, x=table_x)
    if before_object is not None:
        before_object(plant)
    handle = AddGridObject(plant, scene_graph, Model(obj, params), base, table=[table], **options)
    if after_object is not None:
        after_object(plant, scene_graph, handle, table)
    plant.Finalize()
    diagram = builder.Build()
    return Scene(plant, scene_graph, handle, table, diagram, Simulator(diagram))


def parse_sdf(path: Any, dt: float = 1e-3) -> tuple[MultibodyPlant, SceneGraph]:
    """Parses a file alone with Drake's parser."""
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), dt)
    Parser(plant).AddModels(str(path))
    plant.Finalize()
    return plant, scene_graph
