"""A Drake parser that knows this package's models, and Drake's own meshes for them.

The models are `package://gridpush_drake/...`.

This package's models are made of primitives and need nothing else. `package://drake_models` is what
Drake downloads on demand; where someone has, its meshes of the iiwa and the WSG-50 are shown
instead of the primitives. They are illustration only: contact, inertia and what the robot does stay
the same. Nothing is ever downloaded for them.
"""

import os
import re
from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any
from xml.parsers import expat

from pydrake.geometry import GeometryInstance, IllustrationProperties, Mesh, Role, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import (
    AddWeld,
    FlattenModelDirectives,
    GetScopedFrameByName,
    ModelDirective,
    ModelDirectives,
    PackageMap,
    Parser,
    ProcessModelDirectives,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Joint, ModelInstanceIndex, WeldJoint
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.errors import ScenarioError
from gridpush_drake.files import MAX_TEXT_SIZE, exists, open_file, read_text
from gridpush_drake.units import BYTES_PER_MEGABYTE
from gridpush_drake.yaml_file import MAX_YAML_SIZE, parse_yaml, shorten

PACKAGE_NAME = "gridpush_drake"

ROS_PATH = "ROS_PACKAGE_PATH"
"""Environment variable with the folders in which ROS packages are looked for."""

NO_PACKAGES: Mapping[str, str] = MappingProxyType({})
"""No packages beside those that are always known."""


def find_models() -> Path:
    """Finds the folder of the package's models."""
    return Path(str(files("gridpush_drake"))) / "models"


def AddModelsPackage(package_map: PackageMap) -> None:
    """Makes `package://gridpush_drake/...` known to a package map, once."""
    if not package_map.Contains(PACKAGE_NAME):
        package_map.AddPackageXml(str(find_models() / "package.xml"))


def MakePackageMap(packages: Mapping[str, str] = NO_PACKAGES) -> PackageMap:
    """Makes the map in which `package://NAME/...` is looked up.

    Beside Drake's own packages and this one it has those of the folders in `ROS_PACKAGE_PATH`.

    Args:
        packages: folders of further packages by their names; they go before those of
            `ROS_PACKAGE_PATH`.

    Raises:
        ScenarioError: a folder is not there.
    """
    package_map = PackageMap()
    AddModelsPackage(package_map)
    _add_packages(package_map, packages)
    return package_map


def MakeParser(plant: MultibodyPlant, packages: Mapping[str, str] = NO_PACKAGES) -> Parser:
    """Makes a parser for a plant, with the packages of `MakePackageMap`; it downloads nothing."""
    parser = Parser(plant)
    AddModelsPackage(parser.package_map())
    _add_packages(parser.package_map(), packages)
    return parser


def _add_packages(package_map: PackageMap, packages: Mapping[str, str]) -> None:
    """Adds packages by name, and those of `ROS_PACKAGE_PATH` that are not there yet."""
    for name, folder in packages.items():
        if package_map.Contains(name):
            package_map.Remove(name)
        try:
            package_map.Add(name, folder)
        except RuntimeError as error:
            raise ScenarioError(
                f"packages.{name} is {folder}, which is no folder; expected that of the package"
            ) from error
    if os.environ.get(ROS_PATH):
        ros = PackageMap.MakeEmpty()
        ros.PopulateFromRosPackagePath()
        for name in ros.GetPackageNames():
            if not package_map.Contains(name):
                package_map.Add(name, ros.GetPath(name))


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
"""Largest number of directives of a scene, those of a file counted each time it is included; and of
files that a model is made of, counted likewise."""

EXPECTED_DIRECTIVES = "a file of Drake's model directives"
"""The expected form of a file of directives, for messages."""

MODEL_FILE = "a model: an SDFormat, URDF or MuJoCo file"
"""The expected form of a model's file, for messages."""

MESH_FILE = "a mesh"
"""The expected form of a file that a model shows or touches with, for messages."""

MAX_MESH_SIZE = 1024 * BYTES_PER_MEGABYTE
"""Largest size of a mesh's file, bytes."""

XML_MODELS = (".urdf", ".sdf", ".xml", ".world")
"""How the names of models' files end that are XML."""

MODEL_SUFFIX = ".urdf"
"""How the names of this package's models end."""

OLD_MODEL_SUFFIX = ".sdf"
"""How some of them ended once; see `rename_model`."""

PACKAGE_URL = re.compile(r"(?:package|model)://([^/]+)")
"""How a URL begins that names a package."""


def ProcessDirectives(directives: Sequence[ModelDirective], parser: Parser) -> None:
    """Carries out model directives.

    Drake reads whatever they name: `flatten_directives` and `check_model` come first, once.

    A model may fix itself to the world, as ROS descriptions do with a link `world`. Where a
    directive welds it to a place, it stands there instead.

    Args:
        directives: the directives.
        parser: of a plant that is not finalised, see `MakeParser`.

    Raises:
        ScenarioError: a directive cannot be carried out.
    """
    own_welds: dict[ModelInstanceIndex, list[Joint]] = {}
    plant = parser.plant()
    try:
        for directive in _flatten(directives, parser.package_map()):
            if directive.add_weld:
                child = GetScopedFrameByName(plant, directive.add_weld.child)
                for joint in own_welds.pop(child.model_instance(), []):
                    plant.RemoveJoint(joint)
                Weld(plant, directive.add_weld)
                continue
            for added in ProcessModelDirectives(ModelDirectives(directives=[directive]), parser):
                own_welds[added.model_instance] = list_world_welds(plant, added.model_instance)
    except (RuntimeError, ValueError) as error:
        lines = str(error).splitlines()  # Drake's messages go on with lines of C++
        said = next((line.strip() for line in lines if line.strip()), "cannot be carried out")
        raise ScenarioError(f"directives: {said}") from error


def Weld(plant: MultibodyPlant, weld: AddWeld) -> None:
    """Welds two bodies of a plant as a directive says."""
    X_PC = RigidTransform() if weld.X_PC is None else weld.X_PC.GetDeterministicValue()
    plant.WeldFrames(
        GetScopedFrameByName(plant, weld.parent), GetScopedFrameByName(plant, weld.child), X_PC
    )


def list_world_welds(plant: MultibodyPlant, instance: ModelInstanceIndex) -> list[Joint]:
    """Lists the joints of a model that fix it to the world, before Finalize."""
    joints = [plant.get_joint(index) for index in plant.GetJointIndices(instance)]
    world = plant.world_body().index()
    return [
        joint
        for joint in joints
        if joint.type_name() == WeldJoint.kTypeName and joint.parent_body().index() == world
    ]


def flatten_directives(
    directives: Sequence[ModelDirective], package_map: PackageMap
) -> list[ModelDirective]:
    """Replaces directives that include files by what the files hold, down to the last one.

    Drake opens whatever it finds there, a pipe too, reads it without bounds, and follows a file
    that includes itself until its memory ends. So all files are checked first.

    Args:
        directives: the scene's.
        package_map: in which packages are looked up.

    Raises:
        ScenarioError: a file cannot be read, is too large, is no YAML, or includes itself; a
            package is not known; there are too many directives; or one cannot be carried out.
    """
    check_directives(directives, package_map)
    try:
        return _flatten(directives, package_map)
    except (RuntimeError, ValueError) as error:
        raise ScenarioError(f"directives: {' '.join(str(error).split())}") from error


def _flatten(directives: Sequence[ModelDirective], package_map: PackageMap) -> list[ModelDirective]:
    """Flattens directives whose files were checked."""
    whole = ModelDirectives(directives=list(directives))
    flat: list[ModelDirective] = FlattenModelDirectives(whole, package_map).directives
    for directive in flat:
        if directive.add_model:
            directive.add_model.file = rename_model(directive.add_model.file)
    return flat


def rename_model(url: str) -> str:
    """Returns the URL of today for a model of this package that was an SDFormat file once.

    These models are URDF files, which Drake reads eight times as fast (5 ms instead of 40 ms each).
    Scenes of old name them by their old files.
    """
    if url.startswith(f"package://{PACKAGE_NAME}/") and url.endswith(OLD_MODEL_SUFFIX):
        return url.removesuffix(OLD_MODEL_SUFFIX) + MODEL_SUFFIX
    return url


def check_directives(directives: Sequence[ModelDirective], package_map: PackageMap) -> None:
    """Checks the files that directives name, before Drake reads them; see `flatten_directives`.

    Args:
        directives: the scene's.
        package_map: in which packages are looked up.

    Raises:
        ScenarioError: a file cannot be read, is too large, is no YAML, or includes itself; a
            package is not known; or there are too many directives. What else may be wrong is left
            to Drake to say.
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


def check_model(url: str, package_map: PackageMap) -> None:
    """Checks a model's file, those that it includes, and its meshes, before Drake reads them.

    Args:
        url: of an SDFormat, URDF or MuJoCo file.
        package_map: in which packages are looked up.

    Raises:
        ScenarioError: a file cannot be read, is too large, is no XML, or includes itself; or a
            package is not known. What else may be wrong is left to Drake to say.
    """
    path = _resolve(url, package_map, "directives")
    if path is not None:
        _ModelCheck(package_map, path).check(path)


def _resolve(url: str | None, package_map: PackageMap, where: str) -> Path | None:
    """Finds the file of a URL; None where Drake says better why there is none.

    Raises:
        ScenarioError: the URL's package is not known; the message begins with `where`.
    """
    if url is None:
        return None
    package = PACKAGE_URL.match(url)
    if package and not package_map.Contains(package[1]):
        name = package[1]
        raise ScenarioError(
            f"{where}: {shorten(url)}: package {name} is not known; expected its folder in the "
            f"scenario or in the robot.yaml (packages: {{{name}: FOLDER}}), or the folder that it "
            f"lies in, in the environment variable {ROS_PATH}"
        )
    try:
        return Path(package_map.ResolveUrl(url)).resolve()
    except (RuntimeError, ValueError, OSError):
        return None


class _IncludeCheck:
    """A walk through files that include others.

    Attributes:
        open: the files that the walk is within, each included by the one before.
        counts: how many things each finished file stands for.
    """

    def __init__(self, package_map: PackageMap) -> None:
        self._package_map = package_map
        self.open: list[Path] = []
        self.counts: dict[Path, int] = {}

    def _count_file(self, path: Path, count: Callable[[Path], int]) -> int:
        """Returns what a file counts for, by a function that is called once for each file."""
        if path in self.open:
            chain = " includes ".join(map(str, [*self.open[self.open.index(path) :], path]))
            raise ScenarioError(f"directives: {chain}; expected no file that includes itself")
        if path not in self.counts:
            self.open.append(path)
            self.counts[path] = count(path)
            self.open.pop()
        return self.counts[path]


class _DirectivesCheck(_IncludeCheck):
    """A walk through files of directives."""

    def check(self, named: Sequence[tuple[str | None, str | None]]) -> int:
        """Checks what directives name: a file of directives, or a model.

        Returns:
            How many directives there are in all.
        """
        where = f"directives: {self.open[-1]}" if self.open else "directives"
        total = 0
        for included, model in named:
            total += 1
            path = _resolve(included, self._package_map, where)
            if path is not None:
                total += self._count_file(path, self._check_file)
            path = _resolve(model and rename_model(model), self._package_map, where)
            if path is not None:
                open_file(path, MODEL_FILE, ScenarioError, MAX_TEXT_SIZE).close()
            if total > MAX_DIRECTIVES:
                raise ScenarioError(
                    f"directives: there are more than {MAX_DIRECTIVES}, with those of included "
                    "files"
                )
        return total

    def _check_file(self, path: Path) -> int:
        text = read_text(path, EXPECTED_DIRECTIVES, ScenarioError, MAX_YAML_SIZE)
        return self.check(
            _list_named(parse_yaml(path, text, EXPECTED_DIRECTIVES, ScenarioError, tagged=True))
        )


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


class _ModelCheck(_IncludeCheck):
    """A walk through the files of a model."""

    def __init__(self, package_map: PackageMap, model: Path) -> None:
        super().__init__(package_map)
        self._folder = model.parent

    def check(self, path: Path) -> int:
        """Checks a file of the model; returns how many files it stands for."""
        if path.is_dir():  # of an SDFormat model; which of its files counts, model.config says
            return sum(self.check(file) for file in sorted(path.glob("*.sdf")))
        return self._count_file(path, self._check_file)

    def _check_file(self, path: Path) -> int:
        """Checks a file that was not seen yet, with all that it names."""
        with open_file(path, MODEL_FILE, ScenarioError, MAX_TEXT_SIZE) as file:
            if path.suffix.lower() not in XML_MODELS:
                return 1
            named = _list_files(path, file.read())
        total = 1
        for includes, url in named:
            other = self._find(path, url)
            if other is None:
                continue
            if includes:
                total += self.check(other)
            elif not other.is_dir():
                open_file(other, MESH_FILE, ScenarioError, MAX_MESH_SIZE).close()
            if total > MAX_DIRECTIVES:
                raise ScenarioError(f"{path}: includes more than {MAX_DIRECTIVES} files")
        return total

    def _find(self, path: Path, url: str) -> Path | None:
        """Finds a file that a model's file names; None where Drake says better what is wrong."""
        if "://" in url:
            found = _resolve(url, self._package_map, str(path))
            return found if found is not None and exists(found) else None
        for folder in (path.parent, self._folder):  # MuJoCo's includes are beside the first file
            if exists(folder / url):
                return (folder / url).resolve()
        return None


def _list_files(path: Path, text: bytes) -> list[tuple[bool, str]]:
    """Lists the files that a model's XML names, and whether each is included in it.

    These are an SDFormat's `<include><uri>` and `<mesh><uri>`, a MuJoCo file's `<include file>` and
    `<mesh file>`, and a URDF's `<mesh filename>`.

    Raises:
        ScenarioError: the text is no XML.
    """
    named: list[tuple[bool, str]] = []
    within: list[str] = []
    uri: list[str] = []

    def begin(tag: str, attributes: dict[str, str]) -> None:
        within.append(tag)
        uri.clear()
        if tag in ("include", "mesh"):
            files = [attributes[key] for key in ("file", "filename") if key in attributes]
            named.extend((tag == "include", file) for file in files)

    def end(tag: str) -> None:
        within.pop()
        if tag == "uri" and within and within[-1] in ("include", "mesh"):
            named.append((within[-1] == "include", "".join(uri).strip()))

    parser = expat.ParserCreate()
    parser.StartElementHandler = begin
    parser.EndElementHandler = end
    parser.CharacterDataHandler = uri.append
    try:
        parser.Parse(text, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise ScenarioError(f"{path}: is not valid XML: {error}; expected {MODEL_FILE}") from error
    return named


NETWORK_VARIABLE = "DRAKE_ALLOW_NETWORK"
"""Environment variable that keeps Drake's package map from downloading, set to `none` meanwhile."""

_IIWA = "iiwa_description/meshes/iiwa14/visual"
"""Folder of the iiwa's meshes within drake_models."""

_WSG = "wsg_50_description/meshes"
"""Folder of the WSG-50's meshes within drake_models."""

BODY_MESHES: Mapping[str, Sequence[str]] = MappingProxyType(
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

MESHED_MODELS = ("iiwa", "gripper")
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
    for model in MESHED_MODELS:
        if not plant.HasModelInstanceNamed(model):
            continue
        for index in plant.GetBodyIndices(plant.GetModelInstanceByName(model)):
            name = plant.get_body(index).name()
            files = [folder / mesh for mesh in BODY_MESHES.get(name, ())]
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
