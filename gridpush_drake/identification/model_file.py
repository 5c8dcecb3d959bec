"""A learned model as one self-contained YAML file.

It holds the object, its cells' values, and how well they are known. The object stands there as in
an object file, with its very cells. Symmetric matrices are text, exact to the last bit: base64 of
little-endian float64.
"""

import base64
import binascii
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import Field, Strict, model_validator

from gridpush_drake.dynamics.physics import GRAVITY, Physics, SpinModel
from gridpush_drake.errors import GridPushError, IdentificationError
from gridpush_drake.files import read_head, write_whole
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.absolute.estimate import (
    WANTED_UNKNOWNS,
    AbsoluteEstimate,
    TiltingLine,
    TiltTestCheck,
)
from gridpush_drake.identification.absolute.force_scale import ForceScale
from gridpush_drake.identification.identifiability import calc_identifiability
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import HistoryEntry, Identification, IdentificationStatus
from gridpush_drake.identification.statistics.friction_gradient import calc_gradient_std
from gridpush_drake.identification.statistics.noise import NoiseModel
from gridpush_drake.identification.statistics.outliers import Disagreement, Outlier
from gridpush_drake.identification.statistics.posterior import GLOBAL_NAMES, Posterior
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import RENAMED_KEYS as OBJECT_RENAMED
from gridpush_drake.objects.object_file import ObjectSchema, describe_object, make_cells
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.yaml_file import StrictSchema, add_core_forms, check_mapping, read_mapping

FORMAT_VERSION: Literal[2] = 2
"""Version of the form of model files."""

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
PerhapsInfinite = Annotated[float, Field(ge=0, allow_inf_nan=True)]
Point = Annotated[list[float], Field(min_length=2, max_length=2)]
Matrix2 = Annotated[list[Point], Field(min_length=2, max_length=2)]


class CellValuesSchema(StrictSchema):
    """What is known of the cells: one entry a cell, in the order of `object.cells`."""

    mass: list[Positive]
    mass_std: list[Positive]
    mass_min: list[NotNegative]
    mass_max: list[PerhapsInfinite]
    friction: list[NotNegative]
    friction_std: list[NotNegative]
    relative_friction: list[NotNegative]
    relative_friction_std: list[NotNegative]
    learned_share: list[float]


class IdentifiabilitySchema(StrictSchema):
    """What the data determine; see `Identifiability`."""

    statements: list[str]
    center_of_friction: Point
    center_of_friction_covariance: Matrix2
    center_of_mass_box: Matrix2
    learned_directions: Annotated[int, Field(ge=0)]


class DisagreementSchema(StrictSchema):
    """How far off a refused push is; see `Disagreement`."""

    distance: NotNegative
    deviations: NotNegative
    allowed: NotNegative


class OutlierSchema(StrictSchema):
    """What was refused of a push; see `Outlier`."""

    push: str
    poses: list[Annotated[int, Field(ge=0)]]
    observed: Annotated[int, Field(ge=1)]
    whole: bool
    disagreement: DisagreementSchema | None = None


class ForceSchema(StrictSchema):
    """What measured forces say; see `ForceScale`."""

    friction: Positive
    relative_std: NotNegative
    pushes: Annotated[int, Field(ge=1)]
    against: Annotated[int, Field(ge=0)] = 0
    gravity: Positive = GRAVITY


class QuantitySchema(StrictSchema):
    """A positive number, and bounds between which it is with a probability of 95 %."""

    value: Positive
    low: Positive
    high: Positive


class TiltTestSchema(StrictSchema):
    """How a press at the table's edge was judged; see `TiltTestCheck`."""

    place: Point
    arm: Positive
    force: Positive
    expected: float
    residual: float
    line: Annotated[TiltingLine, Strict(False)]
    probability: Annotated[float, Field(ge=0, le=1)]
    support_distance: float | None = None


class AbsoluteSchema(StrictSchema):
    """What weighings say; see `AbsoluteEstimate`.

    Mass, center of mass, friction and inertia are for reading: they follow from the mean and the
    covariance of log m, c_x, c_y and log mu.
    """

    total_mass: QuantitySchema
    center_of_mass: Point
    center_of_mass_std: Point
    friction: QuantitySchema | None = None
    inertia: QuantitySchema | None = None
    presses: Annotated[int, Field(ge=0)]
    lifts: Annotated[int, Field(ge=0)]
    pushes: Annotated[int, Field(ge=0)] = 0
    agreement: Annotated[float, Field(ge=0, le=1)] = 1.0
    gyration: NotNegative = 0.0
    gyration_std: NotNegative = 0.0
    tests: Annotated[list[TiltTestSchema], Field(default_factory=list)]
    center_outlier_probability: Annotated[float, Field(ge=0, le=1)] = 0.0
    mean: Annotated[list[float], Field(min_length=WANTED_UNKNOWNS, max_length=WANTED_UNKNOWNS)]
    covariance: str


class NoiseSchema(StrictSchema):
    """What was taken for granted of the noise, where that is not the default; see `NoiseModel`."""

    pose: Positive
    tip: Positive
    log_contact_friction: Positive
    load_shift: Positive
    prior_weight: Positive
    shift_weight: Positive
    discrepancy_weight: Positive
    push_freedom: Annotated[float, Field(gt=2)] = NoiseModel.push_freedom
    outlier: Positive
    friction_gradient: NotNegative = NoiseModel.friction_gradient


class PhysicsSchema(StrictSchema):
    """What was taken for granted of how objects slide; see `Physics`. Defaults are left out."""

    regime: Literal["quasi_static", "inertial"]
    friction_law: str = Physics.friction_law
    spin: SpinModel = Physics.spin
    gravity: NotNegative = Physics.gravity
    stiction_tolerance: Positive = Physics.stiction_tolerance
    relative_stiction_tolerance: Positive = Physics.relative_stiction_tolerance


class PosteriorSchema(StrictSchema):
    """See `Posterior`. A covariance is base64 of its lower triangle, row by row, float64."""

    mean: list[float]
    covariance: str
    prior_covariance: str


class LearnedObjectSchema(ObjectSchema):
    """The object as in an object file, with a name and its very cells."""

    @model_validator(mode="after")
    def _check_cells(self) -> "LearnedObjectSchema":
        for key in ("name", "cells"):
            if getattr(self, key) is None:
                raise ValueError(f"{key} is missing; expected the object's name and its cells")
        return self


class ModelSchema(StrictSchema):
    """The whole file; see `Identification`."""

    gridpush_model: Literal[2] = Field(description="2, the form that this release reads")
    method: str
    physics: PhysicsSchema
    status: Annotated[IdentificationStatus, Strict(False)]
    message: str
    seed: int
    simulations: Annotated[int, Field(ge=0)]
    noise_std: PerhapsInfinite
    load_shift_std: NotNegative = 0.0
    interval_scale: Annotated[float, Field(gt=0, le=1)] = 1.0
    noise: NoiseSchema | None = None
    training_pushes: list[str]
    unused_pushes: list[str]
    outliers: list[OutlierSchema] = Field(default_factory=list)
    object: LearnedObjectSchema
    contact_friction: NotNegative
    contact_friction_std: NotNegative
    patch_ratio: Annotated[float, Field(ge=0, le=1)] = 1.0
    cells: CellValuesSchema
    identifiability: IdentifiabilitySchema
    force: ForceSchema | None = None
    absolute: AbsoluteSchema | None = None
    history: list[Annotated[tuple[int, float, str], Strict(False)]]
    posterior: PosteriorSchema

    @model_validator(mode="before")
    @classmethod
    def _move_regime(cls, values: Any) -> Any:
        """Files of earlier releases have `regime` by itself, where `physics` stands now."""
        if isinstance(values, dict) and "physics" not in values and "regime" in values:
            values = dict(values)
            values["physics"] = {"regime": values.pop("regime")}
        return values

    @model_validator(mode="after")
    def _check_lengths(self) -> "ModelSchema":
        """Refuses lists that do not have one entry for each cell."""
        assert self.object.cells is not None
        n = len(self.object.cells.centers)
        for name, values in self.cells:
            if len(values) != n:
                raise ValueError(
                    f"cells.{name} has {len(values)} entries; expected one a cell, {n}"
                )
        size = n + len(GLOBAL_NAMES)
        if len(self.posterior.mean) != size:
            more = ", ".join(GLOBAL_NAMES)
            raise ValueError(
                f"posterior.mean has {len(self.posterior.mean)} entries; expected {size}: one a "
                f"cell, then {more}"
            )
        return self


RENAMED_KEYS = {
    **{f"object.{place}": what for place, what in OBJECT_RENAMED.items()},
    "object.cell_size": "this key is called object.cells.size now",
    "object.prior": "its keys stand in object now: total_mass, center_of_mass, friction, "
    "contact_friction, pusher",
    "cells.p_BC": "this key is called object.cells.centers now",
    "cells.labels": "this key is called object.cells.labels now",
    "identifiability.centre_of_friction": "this key is called center_of_friction now",
    "identifiability.centre_of_friction_covariance": "this key is called "
    "center_of_friction_covariance now",
    "identifiability.centre_of_mass_box": "this key is called center_of_mass_box now",
}
"""What became of keys of old, by their place."""


def pack_symmetric(matrix: Array) -> str:
    """Packs the lower triangle of a symmetric matrix, row by row, in lines of 76 characters.

    Args:
        matrix: of which the symmetric part is taken, where rounding has left another.

    Returns:
        The text.
    """
    triangle = ((matrix + matrix.T) / 2)[np.tril_indices(len(matrix))]
    return base64.encodebytes(triangle.astype("<f8").tobytes()).decode()


def unpack_symmetric(name: str, text: str, size: int) -> Array:
    """Unpacks a symmetric matrix.

    Args:
        name: what it is, at the head of an error's message.
        text: by `pack_symmetric`.
        size: rows, and columns.

    Returns:
        (size, size).

    Raises:
        IdentificationError: the text is not base64 of a triangle of that size, of finite numbers.
    """
    values = _decode(name, text)
    if len(values) != size * (size + 1) // 2:
        raise IdentificationError(
            f"{name}: holds {len(values)} numbers; expected the lower triangle of a {size} x "
            f"{size} matrix"
        )
    matrix = np.empty((size, size))
    rows, columns = np.tril_indices(size)
    matrix[rows, columns] = matrix[columns, rows] = values
    return matrix


def _decode(name: str, text: str) -> Array:
    """Reads numbers from base64; an IdentificationError calls them by name."""
    try:
        data = base64.b64decode("".join(text.split()), validate=True)
        values = np.frombuffer(data, dtype="<f8").astype(np.float64)
    except (binascii.Error, ValueError) as error:
        raise IdentificationError(
            f"{name}: expected base64 of little-endian float64 numbers"
        ) from error
    if not np.isfinite(values).all():
        raise IdentificationError(f"{name}: holds a number that is not finite")
    return values


MODEL_FILE = "model.yaml"
"""Name of a model's file in a folder with the pushes that it was learned from."""

EXPECTED_MODEL = "a gridpush model"
"""The expected form of a file, for messages."""

MODEL_KEY = "gridpush_model:"
"""Key with which every model file begins, below its comments."""

MARK_ROOM = 4096
"""Number of bytes at the beginning of a file within which `MODEL_KEY` stands."""

MODEL_HEADER = (
    "# A model that gridpush learned: what the object's cells weigh, how they rub, and how well "
    "that is known.\n# SI units, radians; places are in the object's body frame. `gridpush "
    "predict`, `simulate` and `show` read it.\n# What stands under `identifiability`, and the "
    "cells' relative friction, bounds and learned share, is for reading:\n# it follows from the "
    "posterior at the end, which is exact.\n"
)
"""Comments at the beginning of a model file."""

LINE_WIDTH = 120
"""Characters of a line in a model file."""


def looks_like_model(path: Path | str) -> bool:
    """Whether a file is a model rather than an object; False where it cannot be read."""
    lines = read_head(path, MARK_ROOM).decode(errors="replace").splitlines()
    return any(line.startswith(MODEL_KEY) for line in lines)


def write_model(path: Path | str, identification: Identification, force: bool = False) -> None:
    """Writes a model so that `read_model` gives its numbers back.

    Args:
        path: the YAML file.
        identification: the model.
        force: whether an existing file may be replaced.

    Raises:
        OutputError: the file exists and `force` is not set, or it cannot be written.
    """
    content = _describe(identification).model_dump(exclude_none=True, exclude_unset=True)
    text = yaml.dump(content, Dumper=_Dumper, sort_keys=False, width=LINE_WIDTH)
    write_whole(path, MODEL_HEADER + text, force)


def read_model(path: Path | str) -> Identification:
    """Reads a model; what the file says for people only is worked out again.

    Args:
        path: a YAML file by `write_model`.

    Returns:
        The model.

    Raises:
        ObjectError: the file cannot be read or is not YAML.
        IdentificationError: it is not a model; the message names the file, the field and the
            expected form.
    """
    path = Path(path)
    schema = check_mapping(
        path, read_mapping(path, EXPECTED_MODEL), ModelSchema, IdentificationError, RENAMED_KEYS
    )
    try:
        return _restore(schema)
    except GridPushError as error:
        raise IdentificationError(f"{path}: {error}") from error


def _describe(result: Identification) -> ModelSchema:
    """Collects what a model file says."""
    obj = result.obj
    known = result.identifiability
    spread = result.posterior
    usual = _make_usual_noise(obj)
    return ModelSchema(
        gridpush_model=FORMAT_VERSION,
        method=result.method,
        physics=_describe_physics(result.physics),
        status=result.status,
        message=result.message,
        seed=result.seed,
        simulations=result.simulations,
        noise_std=float(result.noise_std),
        load_shift_std=float(result.load_shift_std),
        interval_scale=float(result.interval_scale),
        noise=None if result.noise == usual else NoiseSchema(**asdict(result.noise)),
        training_pushes=list(result.push_names),
        unused_pushes=list(result.unused_pushes),
        outliers=[
            OutlierSchema.model_validate(asdict(out) | {"poses": list(out.poses)})
            for out in result.outliers
        ],
        object=LearnedObjectSchema.model_validate(
            describe_object(
                obj.name, obj.grid, obj.prior, obj.height, outline_pose=obj.outline_pose
            )
        ),
        contact_friction=result.params.contact_friction,
        contact_friction_std=result.std.contact_friction,
        patch_ratio=result.params.patch_ratio,
        cells=CellValuesSchema(
            mass=result.params.mass.tolist(),
            mass_std=result.std.mass.tolist(),
            mass_min=known.mass_min.tolist(),
            mass_max=known.mass_max.tolist(),
            friction=result.params.friction.tolist(),
            friction_std=result.std.friction.tolist(),
            relative_friction=known.relative_friction.tolist(),
            relative_friction_std=known.relative_friction_std.tolist(),
            learned_share=known.learned_share.tolist(),
        ),
        identifiability=IdentifiabilitySchema(
            statements=list(known.statements),
            center_of_friction=known.center_of_friction.tolist(),
            center_of_friction_covariance=known.center_of_friction_covariance.tolist(),
            center_of_mass_box=known.center_of_mass_box.tolist(),
            learned_directions=int(known.learned_directions),
        ),
        force=None if result.force is None else _describe_force(result.force),
        absolute=None if result.absolute is None else _describe_absolute(result.absolute),
        history=[(entry.simulations, float(entry.loss), entry.stage) for entry in result.history],
        posterior=PosteriorSchema(
            mean=spread.mean.tolist(),
            covariance=pack_symmetric(spread.covariance),
            prior_covariance=pack_symmetric(spread.prior_covariance),
        ),
    )


def _describe_force(force: ForceScale) -> ForceSchema:
    """Sets all values, gravity only where it is not the default."""
    entries = asdict(force)
    if force.gravity == GRAVITY:
        del entries["gravity"]
    return ForceSchema(**entries)


def _describe_absolute(absolute: AbsoluteEstimate) -> AbsoluteSchema:
    """Sets what people read, and the estimate itself."""
    low, high = absolute.mass_interval
    entries: dict[str, Any] = {}
    if absolute.pushes:
        least, most = absolute.friction_interval
        entries["friction"] = QuantitySchema(value=absolute.friction, low=least, high=most)
    if absolute.gyration > 0:
        least, most = absolute.inertia_interval
        entries["inertia"] = QuantitySchema(value=absolute.inertia, low=least, high=most)
    return AbsoluteSchema(
        total_mass=QuantitySchema(value=absolute.total_mass, low=low, high=high),
        center_of_mass=absolute.center_of_mass.tolist(),
        center_of_mass_std=absolute.center_std.tolist(),
        presses=absolute.presses,
        lifts=absolute.lifts,
        pushes=absolute.pushes,
        agreement=absolute.agreement,
        gyration=absolute.gyration,
        gyration_std=absolute.gyration_std,
        tests=[
            TiltTestSchema(**(asdict(one) | {"place": list(one.place)})) for one in absolute.tests
        ],
        center_outlier_probability=absolute.center_outlier_probability,
        mean=absolute.mean.tolist(),
        covariance=pack_symmetric(absolute.covariance),
        **entries,
    )


def _restore_absolute(schema: AbsoluteSchema) -> AbsoluteEstimate:
    """Makes an estimate again of what a file says."""
    return AbsoluteEstimate(
        mean=np.array(schema.mean),
        covariance=unpack_symmetric("absolute.covariance", schema.covariance, WANTED_UNKNOWNS),
        presses=schema.presses,
        lifts=schema.lifts,
        pushes=schema.pushes,
        agreement=schema.agreement,
        gyration=schema.gyration,
        gyration_std=schema.gyration_std,
        tests=tuple(_restore_test(one) for one in schema.tests),
        center_outlier_probability=schema.center_outlier_probability,
    )


def _restore_test(schema: TiltTestSchema) -> TiltTestCheck:
    """Makes the judgment of a press again of what a file says."""
    x, y = schema.place
    return TiltTestCheck(**(schema.model_dump() | {"place": (x, y)}))


def _make_usual_noise(obj: GridObject) -> NoiseModel:
    """Makes the noise model that a file leaves out: the default one, by the friction's bounds."""
    return NoiseModel(friction_gradient=calc_gradient_std(obj.prior))


def _describe_physics(physics: Physics) -> PhysicsSchema:
    """Sets the regime, and whatever else is not the default."""
    standard = asdict(Physics())
    entries = {
        name: value
        for name, value in asdict(physics).items()
        if name == "regime" or value != standard[name]
    }
    return PhysicsSchema(**entries)


def _restore_noise(schema: NoiseSchema | None, obj: GridObject) -> NoiseModel:
    """Makes the noise model again of what a file says, or leaves out."""
    return _make_usual_noise(obj) if schema is None else NoiseModel(**schema.model_dump())


def _restore(schema: ModelSchema) -> Identification:
    """Makes the model again of what a file says."""
    name = str(schema.object.name)
    grid = make_cells(schema.object, name, Path())
    obj = GridObject(
        name=name,
        p_BC=grid.p_BC,
        cell_size=grid.cell_size,
        labels=grid.labels,
        outline=grid.outline,
        prior=schema.object.to_prior(),
        height=schema.object.height,
        outline_pose=schema.object.to_outline_pose(),
    )
    cells = schema.cells
    params = CellParameters(
        mass=np.array(cells.mass),
        friction=np.array(cells.friction),
        contact_friction=schema.contact_friction,
        push_height=obj.prior.push_height or 0.0,
        patch_ratio=schema.patch_ratio,
    )
    std = CellParameters(
        mass=np.array(cells.mass_std),
        friction=np.array(cells.friction_std),
        contact_friction=schema.contact_friction_std,
    )
    size = obj.n + len(GLOBAL_NAMES)
    entries = schema.posterior
    posterior = Posterior(
        np.array(entries.mean),
        unpack_symmetric("posterior.covariance", entries.covariance, size),
        unpack_symmetric("posterior.prior_covariance", entries.prior_covariance, size),
    )
    outliers = [
        Outlier(
            push=out.push,
            poses=tuple(out.poses),
            observed=out.observed,
            whole=out.whole,
            disagreement=None
            if out.disagreement is None
            else Disagreement(**out.disagreement.model_dump()),
        )
        for out in schema.outliers
    ]
    # What the file says for people only is worked out again.
    force = None if schema.force is None else ForceScale(**schema.force.model_dump())
    absolute = None if schema.absolute is None else _restore_absolute(schema.absolute)
    return Identification(
        objects=(obj,),
        parameters=(params,),
        std=std,
        posterior=posterior,
        identifiability=calc_identifiability(Model(obj, params), posterior, force, absolute),
        method=schema.method,
        physics=Physics(**schema.physics.model_dump()),
        status=schema.status,
        message=schema.message,
        history=tuple(HistoryEntry(*entry) for entry in schema.history),
        simulations=schema.simulations,
        noise_std=schema.noise_std,
        load_shift_std=schema.load_shift_std,
        seed=schema.seed,
        push_names=tuple(schema.training_pushes),
        unused_pushes=tuple(schema.unused_pushes),
        outliers=tuple(outliers),
        force=force,
        absolute=absolute,
        interval_scale=schema.interval_scale,
        noise=_restore_noise(schema.noise, obj),
    )


class _Dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]
    """Writes lists on one line, and text of several lines as it stands."""


def _represent_list(dumper: Any, value: list[Any]) -> Any:
    return dumper.represent_sequence("tag:yaml.org,2002:seq", value, flow_style=True)


def _represent_text(dumper: Any, value: str) -> Any:
    return dumper.represent_scalar(
        "tag:yaml.org,2002:str", value, style="|" if "\n" in value else None
    )


add_core_forms(_Dumper)
_Dumper.add_representer(list, _represent_list)
_Dumper.add_representer(tuple, _represent_list)
_Dumper.add_representer(str, _represent_text)
for _words in (IdentificationStatus, TiltingLine):
    _Dumper.add_representer(_words, lambda dumper, value: _represent_text(dumper, str(value)))
