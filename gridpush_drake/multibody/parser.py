"""A Drake parser that knows this package's models, and Drake's own meshes for them.

The models are `package://gridpush_drake/...`.

This package's models are made of primitives and need nothing else. `package://drake_models` is what
Drake downloads on demand; where someone has, its meshes of the iiwa and the WSG-50 are shown
instead of the primitives. They are illustration only: contact, inertia and what the robot does stay
the same. Nothing is ever downloaded for them.
"""

import os
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pydrake.geometry import GeometryInstance, IllustrationProperties, Mesh, Role, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import ModelDirective, PackageMap, Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.errors import ScenarioError
from gridpush_drake.files import MAX_TEXT_SIZE, open_file, read_text
from gridpush_drake.yaml_file import MAX_YAML_SIZE, parse_yaml

PACKAGE = "gridpush_drake"


def find_models() -> Path:
    """Finds the folder of the package's models."""
    return Path(str(files("gridpush_drake"))) / "models"


def AddModelsPackage(package_map: PackageMap) -> None:
    """Makes `package://gridpush_drake/...` known to a package map, once."""
    if not package_map.Contains(PACKAGE):
        package_map.AddPackageXml(str(find_models() / "package.xml"))


def MakeParser(plant: MultibodyPlant) -> Parser:
    """Makes a parser for a plant that finds this package's models, and downloads nothing itself."""
    parser = Parser(plant)
    AddModelsPackage(parser.package_map())
    return parser


def AddPlantAndSceneGraph(
    builder: DiagramBuilder, time_step: float
) -> tuple[MultibodyPlant, SceneGraph]:
    """Adds an empty plant with its scene graph, as Drake's `AddMultibodyPlantSceneGraph` does.

    What Drake's own function adds from Python is never freed, with the whole Diagram: about 0.1 MB
    of an empty plant, 1 MB of a station (Drake 1.51).

    Args:
        builder: of the Diagram.
        time_step: of the plant, s.

    Returns:
        The plant and the scene graph, with the names and the connections that Drake gives them.
    """
    plant = builder.AddNamedSystem("plant", MultibodyPlant(time_step))
    scene_graph = builder.AddNamedSystem("scene_graph", SceneGraph())
    source = plant.RegisterAsSourceForSceneGraph(scene_graph)
    builder.Connect(plant.get_geometry_pose_output_port(), scene_graph.get_source_pose_port(source))
    builder.Connect(
        plant.get_deformable_body_configuration_output_port(),
        scene_graph.get_source_configuration_port(source),
    )
    builder.Connect(scene_graph.get_query_output_port(), plant.get_geometry_query_input_port())
    return plant, scene_graph


MAX_DIRECTIVES = 10_000
"""Largest number of directives of a scene, those of a file counted each time it is included."""

DIRECTIVES = "a file of Drake's model directives"
"""The expected form of a file of directives, for messages."""

MODEL_FILE = "a model: an SDFormat, URDF or MuJoCo file"
"""The expected form of a model's file, for messages."""


def check_directives(directives: Sequence[ModelDirective], package_map: PackageMap) -> None:
    """Checks the files that directives name, before Drake reads them.

    Drake opens whatever it finds there, a pipe too, reads it without bounds, and follows a file
    that includes itself until its memory ends.

    Args:
        directives: the scene's.
        package_map: in which packages are looked up.

    Raises:
        ScenarioError: a file cannot be read, is too large, is no YAML, or includes itself; or there
            are too many directives. What else may be wrong is left to Drake to say.
    """
    _DirectivesCheck(package_map).check(
        [
            (
                d.add_directives.file if d.add_directives else None,
                d.add_model.file if d.add_model else None,
            )
            for d in directives
        ]
    )


class _DirectivesCheck:
    """A walk through included files.

    Attributes:
        open: the files that the walk is within, each included by the one before.
        counts: how many directives each finished file stands for.
    """

    def __init__(self, package_map: PackageMap) -> None:
        self._package_map = package_map
        self.open: list[Path] = []
        self.counts: dict[Path, int] = {}

    def check(self, named: Sequence[tuple[str | None, str | None]]) -> int:
        """Checks what directives name: a file of directives, or a model.

        Returns:
            How many directives there are in all.
        """
        total = 0
        for included, model in named:
            total += 1
            path = self._resolve(included)
            if path is not None:
                total += self._check_file(path)
            path = self._resolve(model)
            if path is not None:
                open_file(path, MODEL_FILE, ScenarioError, MAX_TEXT_SIZE).close()
            if total > MAX_DIRECTIVES:
                raise ScenarioError(
                    f"directives: there are more than {MAX_DIRECTIVES}, with those of included "
                    "files"
                )
        return total

    def _resolve(self, url: str | None) -> Path | None:
        if url is None:
            return None
        try:
            return Path(self._package_map.ResolveUrl(url)).resolve()
        except (RuntimeError, ValueError, OSError):
            return None  # Drake says it better

    def _check_file(self, path: Path) -> int:
        if path in self.open:
            chain = " includes ".join(map(str, [*self.open[self.open.index(path) :], path]))
            raise ScenarioError(f"directives: {chain}; expected no file that includes itself")
        if path not in self.counts:
            text = read_text(path, DIRECTIVES, ScenarioError, MAX_YAML_SIZE)
            data = parse_yaml(path, text, DIRECTIVES, ScenarioError, tagged=True)
            self.open.append(path)
            self.counts[path] = self.check(_list_named(data))
            self.open.pop()
        return self.counts[path]


def _list_named(data: Any) -> list[tuple[str | None, str | None]]:
    """Lists the files of directives and the models that a document of directives names."""
    directives = data.get("directives") if isinstance(data, dict) else None
    if not isinstance(directives, list):
        return []

    def find(directive: Any, key: str) -> str | None:
        named = directive.get(key) if isinstance(directive, dict) else None
        file = named.get("file") if isinstance(named, dict) else None
        return file if isinstance(file, str) else None

    return [(find(each, "add_directives"), find(each, "add_model")) for each in directives]


NETWORK_VARIABLE = "DRAKE_ALLOW_NETWORK"
"""Environment variable that keeps Drake's package map from downloading, set to `none` meanwhile."""

_IIWA = "iiwa_description/meshes/iiwa14/visual"
"""Folder of the iiwa's meshes within drake_models."""

_WSG = "wsg_50_description/meshes"
"""Folder of the WSG-50's meshes within drake_models."""

MESHES: Mapping[str, Sequence[str]] = MappingProxyType(
    {
        "iiwa_link_0": [f"{_IIWA}/link_0.gltf"],
        "iiwa_link_1": [f"{_IIWA}/link_1.gltf"],
        "iiwa_link_2": [f"{_IIWA}/link_2_orange.gltf", f"{_IIWA}/link_2_gray.gltf"],
        "iiwa_link_3": [f"{_IIWA}/link_3.gltf", f"{_IIWA}/band.gltf", f"{_IIWA}/kuka.gltf"],
        "iiwa_link_4": [f"{_IIWA}/link_4_orange.gltf", f"{_IIWA}/link_4_gray.gltf"],
        "iiwa_link_5": [f"{_IIWA}/link_5.gltf"],
        "iiwa_link_6": [f"{_IIWA}/link_6_orange.gltf", f"{_IIWA}/link_6_gray.gltf"],
        "iiwa_link_7": [f"{_IIWA}/link_7.gltf"],
        "body": [f"{_WSG}/wsg_body.gltf"],
        "left_finger": [f"{_WSG}/finger_with_tip.gltf"],
        "right_finger": [f"{_WSG}/finger_with_tip.gltf"],
    }
)
"""Meshes of each body within drake_models. Their frames are the bodies' own."""

MODELS = ("iiwa", "gripper")
"""Names of the model instances that take meshes."""


def find_drake_models() -> Path | None:
    """Finds drake_models in Drake's cache, without network; None where it is not there."""
    before = os.environ.get(NETWORK_VARIABLE)
    os.environ[NETWORK_VARIABLE] = "none"
    try:
        return Path(PackageMap().GetPath("drake_models"))
    except RuntimeError:  # as Drake says that it is not there
        return None
    finally:
        # left set, even Drake's parser would raise
        if before is None:
            del os.environ[NETWORK_VARIABLE]
        else:
            os.environ[NETWORK_VARIABLE] = before


def AddVisualMeshes(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    folder: Path | None,
) -> list[str]:
    """Shows meshes instead of primitives, body by body.

    A body of which a mesh is missing keeps its primitives.

    Args:
        plant: a plant that has its models and is not finalised.
        scene_graph: its SceneGraph.
        folder: the folder of drake_models (`find_drake_models`); None to add nothing.

    Returns:
        The names of the bodies that wear meshes now.
    """
    changed: list[str] = []
    if folder is None:
        return changed
    for model in MODELS:
        if not plant.HasModelInstanceNamed(model):
            continue
        for index in plant.GetBodyIndices(plant.GetModelInstanceByName(model)):
            name = plant.get_body(index).name()
            files = [folder / mesh for mesh in MESHES.get(name, ())]
            if files and all(file.is_file() for file in files):
                _replace_visuals(plant, scene_graph, index, files)
                changed.append(name)
    return changed


def _replace_visuals(
    plant: MultibodyPlant, scene_graph: SceneGraph, body: BodyIndex, files: Sequence[Path]
) -> None:
    source = plant.get_source_id()
    frame = plant.GetBodyFrameIdOrThrow(body)
    scene_graph.RemoveRole(source, frame, Role.kIllustration)
    for file in files:
        # no color of its own, so that the mesh keeps the file's
        geometry = GeometryInstance(RigidTransform(), Mesh(file), f"mesh_{file.stem}")
        geometry.set_illustration_properties(IllustrationProperties())
        plant.RegisterVisualGeometry(plant.get_body(body), geometry)
