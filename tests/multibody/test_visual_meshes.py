"""Drake's meshes instead of primitives, with a drake_models of this test's own making."""

import json
import os

import pytest
from pydrake.geometry import Role
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.multibody.parser import (
    BODY_MESHES,
    NETWORK_VARIABLE,
    AddVisualMeshes,
    MakeParser,
    find_drake_models,
    find_models,
)

TRIANGLE = {
    "asset": {"version": "2.0"},
    "scene": 0,
    "scenes": [{"nodes": [0]}],
    "nodes": [{"mesh": 0}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
    "buffers": [
        {
            "uri": "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA",
            "byteLength": 36,
        }
    ],
    "bufferViews": [{"buffer": 0, "byteLength": 36, "target": 34962}],
    "accessors": [
        {
            "bufferView": 0,
            "componentType": 5126,
            "count": 3,
            "type": "VEC3",
            "min": [0, 0, 0],
            "max": [1, 1, 0],
        }
    ],
}
"""A whole glTF file: corners (0, 0, 0), (1, 0, 0), (0, 1, 0)."""


@pytest.fixture
def drake_models(tmp_path):
    """A folder with a mesh for every body that takes one."""
    for mesh in {mesh for meshes in BODY_MESHES.values() for mesh in meshes}:
        (tmp_path / mesh).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / mesh).write_text(json.dumps(TRIANGLE))
    return tmp_path


class Scene:
    """The robot with finger and gripper, before its plant is finalised."""

    def __init__(self):
        builder = DiagramBuilder()
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, 0.002)
        MakeParser(self.plant).AddModels(str(find_models() / "scenes/iiwa_grasp.dmd.yaml"))
        self.builder = builder

    def shapes(self, body, role=Role.kIllustration):
        """Kinds of a body's shapes."""
        inspector = self.scene_graph.model_inspector()
        frame = self.plant.GetBodyFrameIdOrThrow(self.plant.GetBodyByName(body).index())
        return [
            type(inspector.GetShape(geometry)).__name__
            for geometry in inspector.GetGeometries(frame, role)
        ]

    def contact_shapes(self):
        return {body: self.shapes(body, Role.kProximity) for body in BODY_MESHES}


def test_every_changed_body_shows_its_meshes_alone_and_touches_as_before(drake_models):
    scene = Scene()
    before = scene.contact_shapes()
    assert sorted(AddVisualMeshes(scene.plant, scene.scene_graph, drake_models)) == sorted(
        BODY_MESHES
    )
    for body, meshes in BODY_MESHES.items():
        assert scene.shapes(body) == ["Mesh"] * len(meshes)
    assert scene.shapes("finger_tip") == ["Sphere"]
    assert scene.contact_shapes() == before
    scene.plant.Finalize()
    scene.builder.Build().CreateDefaultContext()


def test_a_body_that_lacks_a_mesh_keeps_its_primitives(drake_models):
    (drake_models / BODY_MESHES["iiwa_link_2"][1]).unlink()
    scene, bare = Scene(), Scene()
    changed = AddVisualMeshes(scene.plant, scene.scene_graph, drake_models)
    assert sorted(changed) == sorted(set(BODY_MESHES) - {"iiwa_link_2"})
    assert scene.shapes("iiwa_link_2") == bare.shapes("iiwa_link_2")
    assert "Mesh" not in bare.shapes("iiwa_link_2")


def test_without_the_meshes_nothing_is_missing(tmp_path):
    scene, bare = Scene(), Scene()
    assert AddVisualMeshes(scene.plant, scene.scene_graph, None) == []
    assert AddVisualMeshes(scene.plant, scene.scene_graph, tmp_path) == []
    assert all(scene.shapes(body) == bare.shapes(body) != [] for body in BODY_MESHES)


def test_models_that_are_not_there_are_passed_over(drake_models):
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.002)
    MakeParser(plant).AddModels(str(find_models() / "tables/round.urdf"))
    assert AddVisualMeshes(plant, scene_graph, drake_models) == []


@pytest.mark.parametrize("before", [None, "package_map", "none"])
def test_looking_for_them_downloads_nothing_and_leaves_the_environment_alone(
    before, monkeypatch, tmp_path
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # an empty cache
    monkeypatch.delenv(NETWORK_VARIABLE, raising=False)
    if before is not None:
        monkeypatch.setenv(NETWORK_VARIABLE, before)
    environment = dict(os.environ)
    assert find_drake_models() is None
    assert dict(os.environ) == environment
