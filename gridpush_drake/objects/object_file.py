"""Object files: an object's outline or mask and what is known of it, as YAML; and those that are shipped.

The object file's schema, and its complaints in words a user can act on.
"""

from collections.abc import Callable
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import shapely
import yaml
from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError
from shapely import LinearRing, MultiPolygon, Polygon

from gridpush_drake.errors import ObjectError, ParameterError
from gridpush_drake.files import write_whole
from gridpush_drake.objects.cells import object_from_outline, polygon_from
from gridpush_drake.objects.grid_object import DEFAULT_MAX_CELLS, MAX_CELLS, MAX_LABEL, GridObject, PhysicalPrior
from gridpush_drake.objects.mask import object_from_mask
from gridpush_drake.yaml_file import explain, read_mapping

Point = Annotated[tuple[float, float], Strict(False)]
Points = Annotated[list[Point], Field(min_length=3)]
Positive = Annotated[float, Field(gt=0)]
Label = Annotated[int, Field(ge=1, le=MAX_LABEL)]


class _Schema(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class MaskSchema(_Schema):
    """A label image, beside the object file, and its scale in m."""

    image: str
    meters_per_pixel: Positive


class PartSchema(_Schema):
    """A part of an outline: its label and where it is, body frame, m."""

    label: Label
    outline: Points


class CellsSchema(_Schema):
    """The very cells of an outline, body frame, m, instead of filling it; labels are 1 where not given."""

    size: Positive
    centers: Annotated[list[Point], Field(min_length=1)]
    labels: list[Label] | None = None


class CenterOfMassSchema(_Schema):
    """Prior of the center of mass, body frame, m."""

    at: Point
    std: Positive = PhysicalPrior.center_of_mass_std


class FrictionSchema(_Schema):
    """Prior of the friction of a cell against the support."""

    prior: Positive = PhysicalPrior.friction
    min: Positive = PhysicalPrior.friction_min
    max: Positive = PhysicalPrior.friction_max


class ContactFrictionSchema(_Schema):
    """Prior of the friction of the pusher against the object."""

    prior: Annotated[float, Field(ge=0)] = PhysicalPrior.contact_friction
    std: Positive = PhysicalPrior.contact_friction_std


class PusherSchema(_Schema):
    """The disc that pushes, m."""

    radius: Positive


class ObjectSchema(_Schema):
    """A whole object file."""

    name: Annotated[str, Field(min_length=1)] | None = None
    outline: Points | None = None
    holes: list[Points] = []
    parts: list[PartSchema] = []
    mask: MaskSchema | None = None
    cells: CellsSchema | None = None
    max_cells: Annotated[int, Field(ge=1, le=MAX_CELLS)] = DEFAULT_MAX_CELLS
    total_mass: Positive | None = None
    center_of_mass: CenterOfMassSchema | None = None
    friction: FrictionSchema = FrictionSchema()
    contact_friction: ContactFrictionSchema = ContactFrictionSchema()
    pusher: PusherSchema | None = None

    def to_prior(self) -> PhysicalPrior:
        """What the file says of mass and friction.

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
        )


POINTS = "at least three points [x, y], in meters"

EXPECTED = {
    "name": "some text",
    "outline": POINTS,
    "holes": f"a list of holes, each {POINTS}",
    "parts": "a list of parts, each with a label and an outline",
    "parts.label": f"a whole number, 1 or more, at most {MAX_LABEL}",
    "parts.outline": POINTS,
    "mask": "image and meters_per_pixel",
    "mask.image": "the name of a PGM or PNG file beside this one",
    "mask.meters_per_pixel": "a positive number, in meters",
    "cells": "size, centers and, where there are several parts, labels",
    "cells.size": "a positive number, in meters",
    "cells.centers": "a list of points [x, y], in meters",
    "cells.labels": f"a list of whole numbers, 1 or more, at most {MAX_LABEL}, one a cell",
    "max_cells": f"a whole number, 1 or more, at most {MAX_CELLS}",
    "total_mass": "a positive number, in kg",
    "center_of_mass": "at: [x, y] and std, in meters",
    "center_of_mass.at": "a point [x, y], in meters",
    "center_of_mass.std": "a positive number, in meters",
    "friction": "prior, min and max",
    "friction.prior": "a positive number",
    "friction.min": "a positive number",
    "friction.max": "a positive number",
    "contact_friction": "prior and std",
    "contact_friction.prior": "a number, 0 or more",
    "contact_friction.std": "a positive number",
    "pusher": "radius",
    "pusher.radius": "a positive number, in meters",
}
"""What each field should hold, by its place without indices."""


WHAT = "an object file (name, outline or mask, max_cells, ...)"

PART_REACH = 0.501
"""Half the side of the square written for a part's cell, in cell sides: a little over, so that neighbors join."""


def read_object(path: Path | str, *, largest_piece: bool = False) -> GridObject:
    """Reads an object file.

    Args:
        path: the YAML file; a mask it names is looked up beside it.
        largest_piece: keep the largest connected piece of a mask that has several.

    Returns:
        The object, with its `prior` as the file says.

    Raises:
        ObjectError: the file cannot be read, has an unknown key or a value out of range; the message names the
            file, the field and the expected form.
    """
    path = Path(path)
    data = read_mapping(path, WHAT)
    try:
        schema = ObjectSchema.model_validate(data)
        prior = schema.to_prior()
    except ValidationError as error:
        raise ObjectError(f"{path}: {explain(error, EXPECTED)}") from error
    except ParameterError as error:
        raise ObjectError(f"{path}: {error}") from error
    if (schema.outline is None) == (schema.mask is None):
        found = "neither" if schema.mask is None else "both"
        raise ObjectError(f"{path}: has {found} of outline and mask; expected exactly one of them")
    name = path.stem if schema.name is None else schema.name
    if schema.cells is not None and (schema.mask is not None or schema.parts or "max_cells" in data):
        raise ObjectError(f"{path}: cells are the object's own; expected no mask, parts or max_cells beside them")
    if schema.mask is not None:
        for key in ("holes", "parts"):
            if getattr(schema, key):
                raise ObjectError(f"{path}: {key} goes with outline; a mask's own background and labels say it")
        image, scale = path.parent / schema.mask.image, schema.mask.meters_per_pixel
        options = {"largest_piece": largest_piece, "name": name, "prior": prior}
        return _in_file(path, object_from_mask, image, scale, schema.max_cells, **options)
    return _in_file(path, _take_cells if schema.cells else _fill_outline, schema, name, prior)


def write_object(path: Path | str, obj: GridObject, *, max_cells: int | None = None, force: bool = False) -> None:
    """Writes an object as an outline with its cells and prior, so that `read_object` gives it back, bit for bit.

    Args:
        path: the YAML file to be written.
        obj: the object.
        max_cells: to fill its outline with when it is read; None writes its very cells.
        force: whether an existing file may be replaced.

    Raises:
        OutputError: the file exists and `force` is not set, or it cannot be written.
    """
    prior = obj.prior
    data: dict[str, Any] = {"name": obj.name, "outline": _points(obj.outline.exterior)}
    if obj.outline.interiors:
        data["holes"] = [_points(ring) for ring in obj.outline.interiors]
    if max_cells is None:
        data["cells"] = {"size": obj.cell_size, "centers": obj.p_BC.tolist()}
        if (obj.labels != 1).any():
            data["cells"]["labels"] = obj.labels.tolist()
    else:
        data |= _describe_parts(obj) | {"max_cells": int(max_cells)}
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
    text = yaml.safe_dump(data, sort_keys=False, default_flow_style=None, allow_unicode=True)
    write_whole(path, text, force)


def list_shipped_objects() -> list[str]:
    """Names of the objects that come with the package, sorted."""
    return sorted(path.stem for path in _shipped_folder().glob("*.yaml"))


def find_shipped_object(name: str) -> Path:
    """Finds the file of an object that comes with the package.

    Args:
        name: as `list_shipped_objects` gives it.

    Returns:
        The file's path.

    Raises:
        ObjectError: there is none of that name; the message suggests the nearest and lists all.
    """
    known = list_shipped_objects()
    if name in known:
        return _shipped_folder() / f"{name}.yaml"
    near = get_close_matches(name, known, n=1)
    guess = f"; did you mean {near[0]}?" if near else "."
    raise ObjectError(f"{name}: no shipped object has this name{guess} Shipped are: {', '.join(known)}")


def _shipped_folder() -> Path:
    return Path(str(files("gridpush_drake"))) / "models" / "objects"


def _in_file(path: Path, make: Callable[..., GridObject], *arguments: Any, **options: Any) -> GridObject:
    try:
        return make(*arguments, **options)
    except ObjectError as error:
        raise ObjectError(f"{path}: {error}") from error


def _fill_outline(schema: ObjectSchema, name: str, prior: PhysicalPrior) -> GridObject:
    assert schema.outline is not None
    outline = polygon_from(schema.outline, "outline", tuple(schema.holes))
    by_label: dict[int, list[Polygon]] = {}
    for i, part in enumerate(schema.parts):
        by_label.setdefault(part.label, []).append(polygon_from(part.outline, f"parts[{i}].outline"))
    parts = {label: shapely.union_all(pieces) for label, pieces in by_label.items()}
    return object_from_outline(outline, parts, schema.max_cells, name=name, prior=prior)


def _take_cells(schema: ObjectSchema, name: str, prior: PhysicalPrior) -> GridObject:
    assert schema.outline is not None
    assert schema.cells is not None
    cells = schema.cells
    labels = [1] * len(cells.centers) if cells.labels is None else cells.labels
    if len(labels) != len(cells.centers):
        raise ObjectError(f"cells.labels has {len(labels)} entries; expected {len(cells.centers)}, one a cell")
    outline = polygon_from(schema.outline, "outline", tuple(schema.holes))
    return GridObject(name, np.array(cells.centers), cells.size, np.array(labels), outline, prior)


def _describe_parts(obj: GridObject) -> dict[str, Any]:
    """`parts`: the squares of each part's cells, joined; nothing where part 1 is the only one."""
    labels = sorted({int(label) for label in obj.labels} - {1})
    parts = []
    for label in labels:
        low = obj.p_BC[obj.labels == label] - obj.cell_size * PART_REACH
        boxes = shapely.box(*low.T, *(low + 2 * obj.cell_size * PART_REACH).T)
        joined = shapely.union_all(boxes).simplify(obj.cell_size * (PART_REACH - 0.5))
        parts += [{"label": label, "outline": _points(piece.exterior)} for piece in _without_holes(joined)]
    return {"parts": parts} if parts else {}


def _without_holes(shape: Polygon | MultiPolygon) -> list[Polygon]:
    """Polygons that together cover `shape`, each cut through the middle of its holes."""
    if isinstance(shape, MultiPolygon):
        return [piece for polygon in shape.geoms for piece in _without_holes(polygon)]
    if not shape.interiors:
        return [shape]
    middle = shape.interiors[0].centroid.x
    left, low, right, high = shape.bounds
    halves = [shape & shapely.box(left, low, middle, high), shape & shapely.box(middle, low, right, high)]
    return [piece for half in halves for piece in _without_holes(half)]


def _points(ring: LinearRing) -> list[list[float]]:
    return [[float(x), float(y)] for x, y in ring.coords[:-1]]
