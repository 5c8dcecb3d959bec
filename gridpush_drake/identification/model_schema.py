"""The schema of a model file."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError, model_validator

from gridpush_drake.errors import IdentificationError

FORMAT_VERSION: Literal[1] = 1

Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Point = Annotated[list[Number], Field(min_length=2, max_length=2)]
Ring = Annotated[list[Point], Field(min_length=3)]
Matrix2 = Annotated[list[Point], Field(min_length=2, max_length=2)]


class _Schema(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class PriorSchema(_Schema):
    """What was known beforehand; see `PhysicalPrior`."""

    total_mass: Positive | None = None
    centre_of_mass: Point | None = None
    centre_of_mass_std: Positive
    friction: Positive
    friction_min: Positive
    friction_max: Positive
    contact_friction: NotNegative
    contact_friction_std: Positive
    pusher_radius: Positive | None = None


class ObjectSchema(_Schema):
    """The object, its cells apart; see `GridObject`."""

    name: str
    cell_size: Positive
    outline: Ring
    holes: list[Ring]
    prior: PriorSchema


class CellsSchema(_Schema):
    """One entry a cell."""

    p_BC: Annotated[list[Point], Field(min_length=1)]
    labels: list[int]
    mass: list[Positive]
    mass_std: list[Positive]
    mass_min: list[NotNegative]
    mass_max: list[Annotated[float, Field(ge=0)]]
    friction: list[NotNegative]
    friction_std: list[NotNegative]
    relative_friction: list[NotNegative]
    relative_friction_std: list[NotNegative]
    learned_share: list[Number]

    @model_validator(mode="after")
    def _check_lengths(self) -> "CellsSchema":
        for name, values in self:
            if len(values) != len(self.p_BC):
                raise ValueError(f"{name} has {len(values)} entries; expected one a cell, {len(self.p_BC)}")
        return self


class IdentifiabilitySchema(_Schema):
    """What the data determine; see `Identifiability`."""

    statements: list[str]
    centre_of_friction: Point
    centre_of_friction_covariance: Matrix2
    centre_of_mass_box: Matrix2
    learned_directions: Annotated[int, Field(ge=0)]


class PosteriorSchema(_Schema):
    """See `Posterior`. A covariance is base64 of its lower triangle, row by row, float64."""

    mean: list[Number]
    covariance: str
    prior_covariance: str


class ModelSchema(_Schema):
    """The whole file; see `Identification`."""

    gridpush_model: Literal[1]
    method: str
    regime: Literal["quasi_static", "inertial"]
    status: str
    message: str
    seed: int
    simulations: Annotated[int, Field(ge=0)]
    noise_std: Annotated[float, Field(ge=0)]
    training_pushes: list[str]
    unused_pushes: list[str]
    object: ObjectSchema
    contact_friction: NotNegative
    contact_friction_std: NotNegative
    cells: CellsSchema
    identifiability: IdentifiabilitySchema
    history: list[Annotated[tuple[int, Number, str], Strict(False)]]
    posterior: PosteriorSchema

    @model_validator(mode="after")
    def _check_posterior(self) -> "ModelSchema":
        expected = len(self.cells.p_BC) + 1
        if len(self.posterior.mean) != expected:
            raise ValueError(f"posterior.mean has {len(self.posterior.mean)} entries; expected {expected}, cells + 1")
        return self


def check_model(path: Path, content: dict[str, Any]) -> ModelSchema:
    """Checks what was read from a model file.

    Args:
        path: of the file, for messages.
        content: the YAML mapping.

    Returns:
        The content, checked.

    Raises:
        IdentificationError: a key is missing, unknown or of the wrong form; the message names the first.
    """
    try:
        return ModelSchema.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"]) or "model"
        message = str(first["msg"]).removeprefix("Value error, ")
        raise IdentificationError(f"{path}: {field}: {message[:1].lower()}{message[1:]}") from None
