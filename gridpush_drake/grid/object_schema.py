"""The object file's schema, and its complaints in words a user can act on."""

from difflib import get_close_matches
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError

from gridpush_drake.grid.object import DEFAULT_MAX_CELLS, MAX_CELLS, MAX_LABEL
from gridpush_drake.grid.prior import PhysicalPrior

Point = Annotated[tuple[float, float], Strict(False)]
Points = Annotated[list[Point], Field(min_length=3)]
Positive = Annotated[float, Field(gt=0)]
Label = Annotated[int, Field(ge=1, le=MAX_LABEL)]

MOST_SHOWN = 60
"""Characters of a refused value that a message repeats."""


class _Schema(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class MaskSchema(_Schema):
    """A label image, beside the object file, and its scale in m."""

    image: str
    metres_per_pixel: Positive


class PartSchema(_Schema):
    """A part of an outline: its label and where it is, body frame, m."""

    label: Label
    outline: Points


class CellsSchema(_Schema):
    """The very cells of an outline, body frame, m, instead of filling it; labels are 1 where not given."""

    size: Positive
    centres: Annotated[list[Point], Field(min_length=1)]
    labels: list[Label] | None = None


class CentreOfMassSchema(_Schema):
    """Prior of the centre of mass, body frame, m."""

    at: Point
    std: Positive = PhysicalPrior.centre_of_mass_std


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
    centre_of_mass: CentreOfMassSchema | None = None
    friction: FrictionSchema = FrictionSchema()
    contact_friction: ContactFrictionSchema = ContactFrictionSchema()
    pusher: PusherSchema | None = None

    def to_prior(self) -> PhysicalPrior:
        """What the file says of mass and friction.

        Raises:
            ParameterError: the values do not fit together.
        """
        centre = self.centre_of_mass
        return PhysicalPrior(
            total_mass=self.total_mass,
            centre_of_mass=centre.at if centre else None,
            centre_of_mass_std=centre.std if centre else PhysicalPrior.centre_of_mass_std,
            friction=self.friction.prior,
            friction_min=self.friction.min,
            friction_max=self.friction.max,
            contact_friction=self.contact_friction.prior,
            contact_friction_std=self.contact_friction.std,
            pusher_radius=self.pusher.radius if self.pusher else None,
        )


POINTS = "at least three points [x, y], in metres"

EXPECTED = {
    "name": "some text",
    "outline": POINTS,
    "holes": f"a list of holes, each {POINTS}",
    "parts": "a list of parts, each with a label and an outline",
    "parts.label": f"a whole number, 1 or more, at most {MAX_LABEL}",
    "parts.outline": POINTS,
    "mask": "image and metres_per_pixel",
    "mask.image": "the name of a PGM or PNG file beside this one",
    "mask.metres_per_pixel": "a positive number, in metres",
    "cells": "size, centres and, where there are several parts, labels",
    "cells.size": "a positive number, in metres",
    "cells.centres": "a list of points [x, y], in metres",
    "cells.labels": f"a list of whole numbers, 1 or more, at most {MAX_LABEL}, one a cell",
    "max_cells": f"a whole number, 1 or more, at most {MAX_CELLS}",
    "total_mass": "a positive number, in kg",
    "centre_of_mass": "at: [x, y] and std, in metres",
    "centre_of_mass.at": "a point [x, y], in metres",
    "centre_of_mass.std": "a positive number, in metres",
    "friction": "prior, min and max",
    "friction.prior": "a positive number",
    "friction.min": "a positive number",
    "friction.max": "a positive number",
    "contact_friction": "prior and std",
    "contact_friction.prior": "a number, 0 or more",
    "contact_friction.std": "a positive number",
    "pusher": "radius",
    "pusher.radius": "a positive number, in metres",
}
"""What each field should hold, by its place without indices."""


UNKNOWN_KEY = ("extra_forbidden", "invalid_key")
"""Pydantic's names for a key that the schema does not have; said first, as a misspelt key explains a missing one."""


def explain(error: ValidationError) -> str:
    """Says the first thing that is wrong, with the field's place and what is expected there."""
    first = min(error.errors(), key=lambda e: e["type"] not in UNKNOWN_KEY)
    place = first["loc"]
    field = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in place).lstrip(".")
    if first["type"] in UNKNOWN_KEY:
        return f"{field}: {_suggest([step for step in place[:-1] if isinstance(step, str)], str(place[-1]))}"
    names = [step for step in place if isinstance(step, str)]
    expected = EXPECTED.get(".".join(names), "something else")
    if first["type"] == "missing":
        return f"{field} is missing; expected {expected}"
    return f"{field} is {_shorten(first['input'])}; expected {expected}"


def _suggest(above: list[str], key: str) -> str:
    known = [path.split(".")[-1] for path in EXPECTED if path.split(".")[:-1] == above]
    near = get_close_matches(key, known, n=1)
    guess = f"; did you mean {near[0]}?" if near else ";"
    return f"unknown key{guess} expected one of {', '.join(known)}"


def _shorten(value: Any) -> str:
    text = "empty" if value is None else repr(value)
    return text if len(text) <= MOST_SHOWN else text[: MOST_SHOWN - 3] + "..."
