"""A Drake parser that knows this package's models as `package://gridpush_drake/...`; and Drake's own meshes for them.

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

from pydrake.geometry import GeometryInstance, IllustrationProperties, Mesh, Role, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import PackageMap, Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex

PACKAGE = "gridpush_drake"


def find_models() -> Path:
    """The folder of the package's models."""
    return Path(str(files("gridpush_drake"))) / "models"


def AddModelsPackage(package_map: PackageMap) -> None:
    """Makes `package://gridpush_drake/...` known to a package map, once."""
    if not package_map.Contains(PACKAGE):
        package_map.AddPackageXml(str(find_models() / "package.xml"))


def MakeParser(plant: MultibodyPlant) -> Parser:
    """Makes a parser for `plant` that finds this package's models; it downloads nothing by itself."""
    parser = Parser(plant)
    AddModelsPackage(parser.package_map())
    return parser


NETWORK_VARIABLE = "DRAKE_ALLOW_NETWORK"
"""Environment variable by which Drake's package map is kept from downloading; set to `none` while
it is asked."""

_IIWA, _WSG = "iiwa_description/meshes/iiwa14/visual", "wsg_50_description/meshes"

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
"""Of each body, its meshes within drake_models. Their frames are the bodies' own."""

MODELS = ("iiwa", "gripper")  # names of the model instances that take meshes


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
    """Shows meshes instead of primitives, body by body; a body of which a mesh is missing keeps its primitives.

    The plant has its models and is not finalised; without a folder (`find_drake_models`) nothing is
    added. Returns the names of the bodies that wear meshes now.
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
    source, frame = plant.get_source_id(), plant.GetBodyFrameIdOrThrow(body)
    scene_graph.RemoveRole(source, frame, Role.kIllustration)
    for file in files:
        # no color of its own, so that the mesh keeps the file's
        geometry = GeometryInstance(RigidTransform(), Mesh(file), f"mesh_{file.stem}")
        geometry.set_illustration_properties(IllustrationProperties())
        plant.RegisterVisualGeometry(plant.get_body(body), geometry)
