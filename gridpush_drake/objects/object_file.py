"""Object files: an object's outline or mask and what is known of it, as YAML; and shipped objects.

The form is described for users in `docs/howto/own_object.md`. Learned models, whose files hold an
object of this form, are read and written in `identification.model_file`.
"""

import unicodedata
from dataclasses import asdict, dataclass, replace
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import shapely
from pydantic import Field, Strict, field_validator, model_validator
from shapely import LinearRing, Polygon

from gridpush_drake.errors import ObjectError, ParameterError
from gridpush_drake.geometry.se2 import IntArray, check_vector
from gridpush_drake.objects.cells import (
    DEFAULT_MAX_CELLS,
    MAX_CELLS,
    MAX_LABEL,
    MIN_SIZE,
    CellGrid,
    check_cells,
)
from gridpush_drake.objects.mask import coarsen_mask
from gridpush_drake.objects.outline import MAX_SIZE, fill_outline, make_polygon
from gridpush_drake.units import DEG_PER_RAD, MM_PER_M
from gridpush_drake.yaml_file import StrictSchema, check_mapping, dump_yaml, read_mapping

LEAST_FRICTION = 1e-6
"""Smallest friction coefficient that is not zero, and smallest such standard deviation. Nothing
that is pushed rubs less."""

GREATEST_FRICTION = 100.0
"""Largest friction coefficient, and largest such standard deviation. Nothing that is pushed rubs
more."""

LEAST_SPREAD = 1e-12
"""Smallest standard deviation of a thing that is known as good as exactly, m or, of a coefficient,
1."""

LEAST_MASS = 1e-9
"""Smallest mass of an object, kg."""

GREATEST_MASS = 1e6
"""Largest mass of an object, kg."""

LEAST_DENSITY = 1e-6
"""Smallest density of a material, in the unit that the file uses for all of them."""

GREATEST_DENSITY = 1e6
"""Largest density of a material, in the same unit."""

GREATEST_SPREAD = 100.0
"""Largest factor by which a material's density may be off. A density that may be off by more is as
good as unknown, and its material is better left out."""

_RANGES = {
    "total_mass": (LEAST_MASS, GREATEST_MASS),
    "center_of_mass_std": (LEAST_SPREAD, MAX_SIZE),
    "friction": (LEAST_FRICTION, GREATEST_FRICTION),
    "friction_min": (LEAST_FRICTION, GREATEST_FRICTION),
    "friction_max": (LEAST_FRICTION, GREATEST_FRICTION),
    "contact_friction": (0.0, GREATEST_FRICTION),
    "contact_friction_std": (LEAST_SPREAD, GREATEST_FRICTION),
    "pusher_radius": (MIN_SIZE, MAX_SIZE),
    "push_height": (MIN_SIZE, MAX_SIZE),
}
"""Least and greatest value of each field of a prior; beyond them calculations overflow."""


UNIFORM_WIDTH = 12.0**0.5
"""Width of a uniform distribution, in its standard deviations."""

UNKNOWN_FRICTION = (0.1, 0.9)
"""Least and greatest friction coefficient of a cell against the table where nothing is told."""

SUPPOSED_FRICTION = 0.3
"""Friction coefficient that is supposed where nothing is told: about the middle of the logarithms
of these bounds."""


@dataclass(frozen=True)
class PartMaterial:
    """What a part of an object is expected to be made of.

    Only the ratios of the densities of an object's materials count, so that their unit is free, as
    long as all have the same.

    Attributes:
        label: the part's label.
        name: the material's name, such as steel.
        density: its density. In kg/m³ it is taken for granted that all parts are about equally
            thick; where the thicknesses are known, kg/m² is better.
        spread: geometric standard deviation of the density: the factor, 1 or more, by which the
            part may well be denser or less dense. It covers the thickness, too.

    Raises:
        ParameterError: a value is out of range.
    """

    label: int
    name: str
    density: float
    spread: float

    def __post_init__(self) -> None:
        for name, (least, greatest) in (
            ("density", (LEAST_DENSITY, GREATEST_DENSITY)),
            ("spread", (1.0, GREATEST_SPREAD)),
        ):
            value = getattr(self, name)
            if not least <= value <= greatest:
                raise ParameterError(
                    f"materials: {self.name}: {name} is {value!r}; expected a number from "
                    f"{least:g} to {greatest:g}"
                )


@dataclass(frozen=True)
class PhysicalPrior:
    """Prior knowledge of an object, all of it optional.

    Attributes:
        total_mass: kg; None where it was not weighed.
        center_of_mass: (x, y) in the body frame, m; None where unknown.
        center_of_mass_std: its standard deviation per axis, m.
        friction: prior friction coefficient of the cells against the support.
        friction_min: smallest coefficient held possible.
        friction_max: largest coefficient held possible.
        contact_friction: prior friction coefficient of the pusher against the object.
        contact_friction_std: its standard deviation.
        pusher_radius: m; None where the object's file does not say.
        push_height: above the table, where the pusher touches, m; it comes with the pusher's
            radius. None where nothing is said of it: every cell is then taken to bear its own
            weight.
        uniform_parts: whether the cells of a part may be of one material, as where they look alike.
        materials: what parts are expected to be made of, each part once. The cells of such a part
            may be of one material, whatever `uniform_parts` says.

    Raises:
        ParameterError: a value is out of range.
    """

    total_mass: float | None = None
    center_of_mass: tuple[float, float] | None = None
    center_of_mass_std: float = 0.002
    friction: float = 0.4
    friction_min: float = 0.05
    friction_max: float = 1.0
    contact_friction: float = 0.5
    contact_friction_std: float = 0.15
    pusher_radius: float | None = None
    push_height: float | None = None
    uniform_parts: bool = False
    materials: tuple[PartMaterial, ...] = ()

    @property
    def friction_std(self) -> float:
        """Standard deviation of a coefficient that may be anything between its bounds."""
        return (self.friction_max - self.friction_min) / UNIFORM_WIDTH

    @property
    def log_friction_std(self) -> float:
        """Standard deviation of its logarithm, if that is evenly distributed between its bounds."""
        return float(np.log(self.friction_max / self.friction_min)) / UNIFORM_WIDTH

    def forget(self) -> "PhysicalPrior":
        """Makes the prior of an object of which nothing is told: mass, center or friction.

        Which parts look alike can still be seen.
        """
        low, high = UNKNOWN_FRICTION
        return replace(
            self,
            total_mass=None,
            center_of_mass=None,
            friction=SUPPOSED_FRICTION,
            friction_min=low,
            friction_max=high,
            materials=(),
        )

    def __post_init__(self) -> None:
        for name, (least, greatest) in _RANGES.items():
            value = getattr(self, name)
            if value is not None and not least <= value <= greatest:
                raise ParameterError(
                    f"{name} is {value!r}; expected a number from {least:g} to {greatest:g}"
                )
        if self.push_height is not None and self.pusher_radius is None:
            raise ParameterError("push_height is given without pusher_radius; expected both")
        if not self.friction_min <= self.friction <= self.friction_max:
            raise ParameterError(
                f"friction.prior is {self.friction!r}; expected min <= prior <= max, "
                f"here {self.friction_min} to {self.friction_max}"
            )
        labels = [material.label for material in self.materials]
        twice = next((label for label in labels if labels.count(label) > 1), None)
        if twice is not None:
            raise ParameterError(f"materials: label {twice} occurs twice; expected each part once")
        if self.center_of_mass is not None:
            x, y = check_vector(
                ParameterError, "center_of_mass.at", self.center_of_mass, 2
            ).tolist()
            object.__setattr__(self, "center_of_mass", (x, y))


@dataclass(frozen=True)
class OutlinePose:
    """Where the frame in which an outline was given is in an object's body frame, X_BO.

    The body frame is the one in which the object's poses are logged.

    Attributes:
        pose: (x, y, theta), m and rad.
        std: standard deviations of these, m and rad; 0 where it was set by hand.
    """

    pose: tuple[float, float, float]
    std: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def describe(self) -> str:
        """Says where it is, and how surely, in mm and degrees."""
        units = (MM_PER_M, MM_PER_M, DEG_PER_RAD)
        known = any(self.std)
        words = []
        for axis, value, std, unit in zip(
            ("x", "y", "theta"), self.pose, self.std, units, strict=True
        ):
            spread = f" ± {std * unit:.1f}" if known else ""
            words.append(f"{axis} {value * unit:.1f}{spread}{'°' if axis == 'theta' else ' mm'}")
        return ", ".join(words)


MAX_RADIUS = 1.0
"""Largest radius of a pusher, m. A larger one is refused, for it was given in millimeters."""

MAX_NAME = 200
"""Largest number of characters of an object's name."""

EXPECTED_NAME = f"some text, at most {MAX_NAME} characters, without control characters"


def speak_name(name: str) -> str:
    """Returns an object's name as people say it: claw hammer for claw_hammer."""
    return name.replace("_", " ")


def is_name(text: str) -> bool:
    """Whether an object can have this name, which XML and YAML files must hold on one line."""
    # Unicode's control characters, half characters and ends of lines
    unfit = ("Cc", "Cs", "Zl", "Zp")
    printable = all(
        unicodedata.category(letter) not in unfit and letter not in "\ufffe\uffff"
        for letter in text
    )
    return 0 < len(text) <= MAX_NAME and printable


OBJECT_FILE = "object.yaml"
"""Name of an object's file in a folder with pushes of it, as runs and imports write it."""

MODEL_KEY = "gridpush_model"
"""The first key of a learned model's file."""

EXPECTED_POINTS = "at least three points [x, y], in meters"
EXPECTED_LABEL = f"a whole number, 1 or more, at most {MAX_LABEL}"

Point = Annotated[tuple[float, float], Strict(False)]
Points = Annotated[list[Point], Field(min_length=3, description=EXPECTED_POINTS)]
EXPECTED_FRICTION = f"a positive number, at most {GREATEST_FRICTION:g}"
Friction = Annotated[
    float, Field(ge=LEAST_FRICTION, le=GREATEST_FRICTION, description=EXPECTED_FRICTION)
]
ContactFriction = Annotated[
    float,
    Field(
        ge=0,
        le=GREATEST_FRICTION,
        description=f"a number, 0 or more, at most {GREATEST_FRICTION:g}",
    ),
]
EXPECTED_LENGTH = f"a positive number, in meters, at most {MAX_SIZE:g}"
Length = Annotated[float, Field(ge=MIN_SIZE, le=MAX_SIZE, description=EXPECTED_LENGTH)]
Label = Annotated[int, Field(ge=1, le=MAX_LABEL)]


class MaskSchema(StrictSchema):
    """A label image, beside the object file, and its scale in m."""

    image: str = Field(description="the name of a PGM or PNG file beside this one")
    meters_per_pixel: Length
    origin: Point | None = Field(
        None,
        description="[x, y] of the body frame's origin in the image, pixels from its upper left "
        "corner",
    )


class PartSchema(StrictSchema):
    """A part of an outline: its label and where it is, body frame, m."""

    label: Label = Field(description=EXPECTED_LABEL)
    outline: Points


class MaterialSchema(StrictSchema):
    """What a part is expected to be made of; see `PartMaterial`."""

    label: Label = Field(description=EXPECTED_LABEL)
    name: str = Field(min_length=1, max_length=MAX_NAME, description=EXPECTED_NAME)
    density: Annotated[float, Field(ge=LEAST_DENSITY, le=GREATEST_DENSITY)] = Field(
        description="a positive number, in kg/m³ or in kg/m², the same for all parts"
    )
    spread: Annotated[float, Field(ge=1, le=GREATEST_SPREAD)] = Field(
        description=f"a factor, 1 or more, at most {GREATEST_SPREAD:g}"
    )

    def to_material(self) -> PartMaterial:
        """Makes the `PartMaterial` that the file describes."""
        return PartMaterial(
            label=self.label, name=self.name, density=self.density, spread=self.spread
        )


class CellsSchema(StrictSchema):
    """The very cells of an outline, which is then not filled with others, body frame, m.

    Labels are 1 where they are not given.
    """

    size: Length
    centers: list[Point] = Field(min_length=1, description="a list of points [x, y], in meters")
    labels: list[Label] | None = Field(
        None, description=f"a list of whole numbers, 1 or more, at most {MAX_LABEL}, one a cell"
    )

    @model_validator(mode="after")
    def _check_labels(self) -> "CellsSchema":
        n = len(self.centers)
        if self.labels is not None and len(self.labels) != n:
            raise ValueError(f"labels has {len(self.labels)} entries; expected {n}, one a cell")
        return self


class CenterOfMassSchema(StrictSchema):
    """Prior of the center of mass, body frame, m."""

    at: Point = Field(description="a point [x, y], in meters")
    std: Annotated[float, Field(ge=LEAST_SPREAD, le=MAX_SIZE, description=EXPECTED_LENGTH)] = (
        PhysicalPrior.center_of_mass_std
    )


class FrictionSchema(StrictSchema):
    """Prior of the friction of a cell against the support."""

    prior: Friction = PhysicalPrior.friction
    min: Friction = PhysicalPrior.friction_min
    max: Friction = PhysicalPrior.friction_max


class ContactFrictionSchema(StrictSchema):
    """Prior of the friction of the pusher against the object."""

    prior: ContactFriction = PhysicalPrior.contact_friction
    std: Annotated[
        float, Field(ge=LEAST_SPREAD, le=GREATEST_FRICTION, description=EXPECTED_FRICTION)
    ] = PhysicalPrior.contact_friction_std


class PusherSchema(StrictSchema):
    """The disc that pushes, and the height above the table at which it does, m."""

    radius: float = Field(
        gt=0, le=MAX_RADIUS, description=f"a positive number, in meters, at most {MAX_RADIUS:g}"
    )
    height: Length | None = Field(None, description=EXPECTED_LENGTH)


class TagSchema(StrictSchema):
    """An AprilTag 36h11 on the object: its number, its side, and the body's pose in it, X_TB."""

    id: int = Field(ge=0, description="a tag's number, a whole number, 0 or more")
    size: Length
    pose: Annotated[tuple[float, float, float], Strict(False)] = Field(
        description="[x, y, theta], in m and rad"
    )


class SeenSchema(StrictSchema):
    """Where the body frame was in the photograph that the object was made of.

    By it the frames of other trackers can be aligned with the object's.
    """

    pixel: Point = Field(description="[x, y] of the body frame's origin in the photograph, pixels")
    pose: Annotated[tuple[float, float, float], Strict(False)] = Field(
        description="[x, y, theta], W, in m and rad"
    )
    tag: TagSchema | None = Field(None, description="id, size and pose")


class OutlinePoseSchema(StrictSchema):
    """Where the frame in which the outline was given first is in the body frame; see `OutlinePose`.

    For reading: outline and cells of the file are in the body frame already.
    """

    pose: Annotated[tuple[float, float, float], Strict(False)] = Field(
        description="[x, y, theta], in m and rad"
    )
    std: Annotated[tuple[float, float, float], Strict(False)] = Field(
        (0.0, 0.0, 0.0), description="[x, y, theta], in m and rad"
    )


class ObjectSchema(StrictSchema):
    """An object: a whole object file, and the object of a model file."""

    name: str | None = Field(None, min_length=1, description=EXPECTED_NAME)
    outline: Points | None = Field(None, description=EXPECTED_POINTS)
    holes: list[Points] = Field([], description=f"a list of holes, each {EXPECTED_POINTS}")
    parts: list[PartSchema] = Field(
        [], description="a list of parts, each with a label and an outline"
    )
    mask: MaskSchema | None = Field(
        None, description="image, meters_per_pixel and, where wanted, origin"
    )
    cells: CellsSchema | None = Field(
        None, description="size, centers and, where there are several parts, labels"
    )
    max_cells: int = Field(
        DEFAULT_MAX_CELLS,
        ge=1,
        le=MAX_CELLS,
        description=f"a whole number, 1 or more, at most {MAX_CELLS}",
    )
    height: Length | None = Field(None, description=EXPECTED_LENGTH)
    seen: SeenSchema | None = Field(None, description="pixel, pose and, where there is one, tag")
    outline_pose: OutlinePoseSchema | None = Field(None, description="pose and std")
    total_mass: float | None = Field(
        None,
        ge=LEAST_MASS,
        le=GREATEST_MASS,
        description=f"a positive number, in kg, at most {GREATEST_MASS:g}",
    )
    center_of_mass: CenterOfMassSchema | None = Field(
        None, description="at: [x, y] and std, in meters"
    )
    friction: FrictionSchema = Field(FrictionSchema(), description="prior, min and max")
    contact_friction: ContactFrictionSchema = Field(
        ContactFrictionSchema(), description="prior and std"
    )
    pusher: PusherSchema | None = Field(
        None, description="radius and, where it is known, height, in meters"
    )
    uniform_parts: bool = Field(False, description="true or false")
    materials: list[MaterialSchema] = Field(
        [], description="a list of materials, each with label, name, density and spread"
    )

    @field_validator("name")
    @classmethod
    def _check_name(cls, name: str | None) -> str | None:
        if name is not None and not is_name(name):
            raise ValueError("no name")
        return name

    @model_validator(mode="after")
    def _check_whole(self) -> "ObjectSchema":
        """Refuses keys that do not go together."""
        try:
            self.to_prior()
        except ParameterError as error:
            raise ValueError(str(error)) from error
        if (self.outline is None) == (self.mask is None):
            found = "neither" if self.mask is None else "both"
            raise ValueError(f"has {found} of outline and mask; expected exactly one of them")
        if self.cells and (self.mask or self.parts or "max_cells" in self.model_fields_set):
            raise ValueError(
                "cells are the object's own; expected no mask, parts or max_cells beside them"
            )
        for key in ("holes", "parts"):
            if self.mask and getattr(self, key):
                raise ValueError(
                    f"{key} goes with outline; a mask's own background and labels say it"
                )
        return self

    def to_outline_pose(self) -> OutlinePose | None:
        """Takes what the file says of the frame in which the outline was given first."""
        where = self.outline_pose
        return None if where is None else OutlinePose(pose=where.pose, std=where.std)

    def to_prior(self) -> PhysicalPrior:
        """Takes what the file says of mass and friction.

        Raises:
            ParameterError: the values do not fit together.
        """
        center = self.center_of_mass
        return PhysicalPrior(
            total_mass=self.total_mass,
            center_of_mass=center.at if center else None,
            center_of_mass_std=center.std if center else PhysicalPrior.center_of_mass_std,
            friction=self.friction.prior,
            friction_min=self.friction.min,
            friction_max=self.friction.max,
            contact_friction=self.contact_friction.prior,
            contact_friction_std=self.contact_friction.std,
            pusher_radius=self.pusher.radius if self.pusher else None,
            push_height=self.pusher.height if self.pusher else None,
            uniform_parts=self.uniform_parts,
            materials=tuple(one.to_material() for one in self.materials),
        )

    def check_materials(self, labels: IntArray) -> None:
        """Refuses a material of a part that the object does not have.

        Args:
            labels: (n,) labels of the object's cells.

        Raises:
            ObjectError: no cell has the material's label.
        """
        known = np.unique(labels).tolist()
        for i, material in enumerate(self.materials):
            if material.label not in known:
                raise ObjectError(
                    f"materials[{i}].label is {material.label}; expected a part that has cells: "
                    f"{', '.join(map(str, known))}"
                )


RENAMED_KEYS = {
    "centre_of_mass": "this key is called center_of_mass now",
    "cells.centres": "this key is called centers now",
    "mask.metres_per_pixel": "this key is called meters_per_pixel now",
}
"""What became of keys of old, by their place in the object."""

EXPECTED_OBJECT = "an object file (name, outline or mask, max_cells, ...)"


def read_object_file(path: Path) -> ObjectSchema:
    """Reads an object file and checks it, but for the mask it may name.

    Raises:
        ObjectError: the file cannot be read, has an unknown key or a value out of range; the
            message names the file, the field and the expected form.
    """
    data = read_mapping(path, EXPECTED_OBJECT)
    if MODEL_KEY in data:
        raise ObjectError(f"{path}: is a learned model; expected {EXPECTED_OBJECT}")
    return check_mapping(path, data, ObjectSchema, ObjectError, RENAMED_KEYS)


def make_cells(
    schema: ObjectSchema, name: str, folder: Path, largest_piece: bool = False
) -> CellGrid:
    """Makes the cells and the outline that a schema describes.

    Args:
        schema: the object file's content.
        name: the object's name, for messages.
        folder: where a mask that it names is looked up.
        largest_piece: whether the largest piece of a mask is taken where there are several.

    Returns:
        Cells and outline.

    Raises:
        ObjectError: a polygon crosses itself or has no area, or the mask cannot be read or is none.
    """
    if schema.mask is not None:
        return coarsen_mask(
            folder / schema.mask.image,
            schema.mask.meters_per_pixel,
            schema.max_cells,
            largest_piece=largest_piece,
            name=name,
            origin=schema.mask.origin,
        )
    assert schema.outline is not None
    outline = make_polygon(schema.outline, "outline", tuple(schema.holes))
    if schema.cells is not None:
        labels = schema.cells.labels or [1] * len(schema.cells.centers)
        grid = CellGrid(
            p_BC=np.array(schema.cells.centers),
            cell_size=schema.cells.size,
            labels=np.array(labels),
            outline=outline,
        )
        check_cells(grid)
        return grid
    # Several outlines may be of one part.
    by_label: dict[int, list[Polygon]] = {}
    for i, part in enumerate(schema.parts):
        by_label.setdefault(part.label, []).append(
            make_polygon(part.outline, f"parts[{i}].outline")
        )
    parts = {label: shapely.union_all(pieces) for label, pieces in by_label.items()}
    return fill_outline(outline, parts, schema.max_cells, name=name)


def describe_object(
    name: str,
    grid: CellGrid,
    prior: PhysicalPrior,
    height: float | None = None,
    seen: SeenSchema | None = None,
    outline_pose: OutlinePose | None = None,
) -> dict[str, Any]:
    """Lists the plain values of an object, in a file's order.

    `ObjectSchema` makes the same object of them again, bit for bit.

    Args:
        name: the object's name.
        grid: its cells and outline.
        prior: what is known of its mass and friction.
        height: its height, m; None where it is not known.
        seen: where its frame was in the photograph it was made of; None without one.
        outline_pose: where the frame in which the outline was given first is in the body frame;
            None where both are the same.

    Returns:
        The values by key.
    """
    data: dict[str, Any] = {"name": name, "outline": _points(grid.outline.exterior)}
    if grid.outline.interiors:
        data["holes"] = [_points(ring) for ring in grid.outline.interiors]
    data["cells"] = {"size": grid.cell_size, "centers": grid.p_BC.tolist()}
    if (grid.labels != 1).any():
        data["cells"]["labels"] = grid.labels.tolist()
    if height is not None:
        data["height"] = float(height)
    if seen is not None:
        data["seen"] = seen.model_dump(mode="json", exclude_none=True)
    if outline_pose is not None:
        data["outline_pose"] = {key: list(value) for key, value in asdict(outline_pose).items()}
    if prior.total_mass is not None:
        data["total_mass"] = float(prior.total_mass)
    if prior.center_of_mass is not None:
        at = [float(value) for value in prior.center_of_mass]
        data["center_of_mass"] = {"at": at, "std": float(prior.center_of_mass_std)}
    friction = {"prior": prior.friction, "min": prior.friction_min, "max": prior.friction_max}
    contact = {"prior": prior.contact_friction, "std": prior.contact_friction_std}
    data["friction"] = {key: float(value) for key, value in friction.items()}
    data["contact_friction"] = {key: float(value) for key, value in contact.items()}
    if prior.pusher_radius is not None:
        data["pusher"] = {"radius": float(prior.pusher_radius)}
        if prior.push_height is not None:
            data["pusher"]["height"] = float(prior.push_height)
    if prior.uniform_parts:
        data["uniform_parts"] = True
    if prior.materials:
        data["materials"] = [asdict(material) for material in prior.materials]
    return data


def dump_object(
    name: str,
    grid: CellGrid,
    prior: PhysicalPrior,
    height: float | None = None,
    seen: SeenSchema | None = None,
    outline_pose: OutlinePose | None = None,
) -> str:
    """An object file's text; the arguments are those of `describe_object`."""
    data = describe_object(name, grid, prior, height=height, seen=seen, outline_pose=outline_pose)
    return dump_yaml(data, default_flow_style=None, allow_unicode=True)


def list_shipped_objects() -> list[str]:
    """Names of the objects that come with the package, sorted."""
    return sorted(path.stem for path in _shipped_folder().glob("*.yaml"))


def find_shipped_object(name: str) -> Path:
    """Finds the file of an object that comes with the package.

    Raises:
        ObjectError: there is none of that name; the message suggests the nearest and lists all.
    """
    known = list_shipped_objects()
    if name in known:
        return _shipped_folder() / f"{name}.yaml"
    near = get_close_matches(name, known, n=1)
    guess = f"; did you mean {near[0]}?" if near else "."
    raise ObjectError(
        f"{name}: no shipped object has this name{guess} Shipped are: {', '.join(known)}"
    )


def _shipped_folder() -> Path:
    return Path(str(files("gridpush_drake"))) / "models" / "objects"


def _points(ring: LinearRing) -> list[list[float]]:
    return [[float(x), float(y)] for x, y in ring.coords[:-1]]
