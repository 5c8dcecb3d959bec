"""A learned model as one self-contained YAML file: the object, its cells' values and how well they are known."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from shapely import Polygon

from gridpush_drake.errors import GridPushError, IdentificationError
from gridpush_drake.files import read_head, write_whole
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.grid.prior import PhysicalPrior
from gridpush_drake.grid.yaml_file import read_mapping
from gridpush_drake.identification.identifiability import calc_identifiability
from gridpush_drake.identification.model_schema import (
    FORMAT_VERSION,
    CellsSchema,
    IdentifiabilitySchema,
    ModelSchema,
    ObjectSchema,
    PosteriorSchema,
    PriorSchema,
    check_model,
)
from gridpush_drake.identification.packing import pack_symmetric, unpack_symmetric
from gridpush_drake.identification.posterior import Posterior
from gridpush_drake.identification.result import HistoryEntry, Identification

WHAT = "a gridpush model"

MARK = "gridpush_model:"
"""The key that every model file begins with, below its comments."""

MARK_ROOM = 4096
"""Bytes within which it stands."""

HEADER = """\
# A model that gridpush learned: what the object's cells weigh, how they rub, and how well that is known.
# SI units, radians; places are in the object's body frame. `gridpush predict`, `simulate` and `show` read it.
# What stands under `identifiability`, and the cells' relative friction, bounds and learned share, is for reading:
# it follows from the posterior at the end, which is exact.
"""

LINE_WIDTH = 120


def looks_like_model(path: Path | str) -> bool:
    """Whether a file is a model rather than an object; False where it cannot be read."""
    lines = read_head(path, MARK_ROOM).decode(errors="replace").splitlines()
    return any(line.startswith(MARK) for line in lines)


def write_model(path: Path | str, identification: Identification, force: bool = False) -> None:
    """Writes a model so that `read_model` gives its numbers back.

    Args:
        path: the YAML file.
        identification: the model.
        force: whether an existing file may be replaced.

    Raises:
        OutputError: the file exists and `force` is not set, or it cannot be written.
    """
    content = _describe(identification).model_dump(exclude_none=True)
    write_whole(path, HEADER + yaml.dump(content, Dumper=_Dumper, sort_keys=False, width=LINE_WIDTH), force)


def read_model(path: Path | str) -> Identification:
    """Reads a model; what the file says for people only is worked out again.

    Args:
        path: a YAML file by `write_model`.

    Returns:
        The model.

    Raises:
        ObjectError: the file cannot be read or is not YAML.
        IdentificationError: it is not a model; the message names the file, the field and the expected form.
    """
    path = Path(path)
    schema = check_model(path, read_mapping(path, WHAT))
    try:
        return _restore(schema)
    except GridPushError as error:
        raise IdentificationError(f"{path}: {error}") from error


def _describe(result: Identification) -> ModelSchema:
    obj, known, spread = result.obj, result.identifiability, result.posterior
    regime: Any = result.regime
    return ModelSchema(
        gridpush_model=FORMAT_VERSION,
        method=result.method,
        regime=regime,
        status=result.status,
        message=result.message,
        seed=result.seed,
        simulations=result.simulations,
        noise_std=float(result.noise_std),
        training_pushes=list(result.push_names),
        unused_pushes=list(result.unused_pushes),
        object=_describe_object(obj),
        contact_friction=result.params.contact_friction,
        contact_friction_std=result.std.contact_friction,
        cells=CellsSchema(
            p_BC=obj.p_BC.tolist(),
            labels=obj.labels.tolist(),
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
            centre_of_friction=known.centre_of_friction.tolist(),
            centre_of_friction_covariance=known.centre_of_friction_covariance.tolist(),
            centre_of_mass_box=known.centre_of_mass_box.tolist(),
            learned_directions=int(known.learned_directions),
        ),
        history=[(entry.simulations, float(entry.loss), entry.stage) for entry in result.history],
        posterior=PosteriorSchema(
            mean=spread.mean.tolist(),
            covariance=pack_symmetric(spread.covariance),
            prior_covariance=pack_symmetric(spread.prior_covariance),
        ),
    )


def _describe_object(obj: GridObject) -> ObjectSchema:
    rings = [[list(point[:2]) for point in ring.coords[:-1]] for ring in (obj.outline.exterior, *obj.outline.interiors)]
    prior: dict[str, Any] = {**vars(obj.prior)}
    prior["centre_of_mass"] = obj.prior.centre_of_mass and list(obj.prior.centre_of_mass)
    return ObjectSchema(
        name=obj.name, cell_size=obj.cell_size, outline=rings[0], holes=rings[1:], prior=PriorSchema(**prior)
    )


def _restore(schema: ModelSchema) -> Identification:
    cells, n = schema.cells, len(schema.cells.p_BC)
    prior = schema.object.prior.model_dump()
    if prior["centre_of_mass"] is not None:
        prior["centre_of_mass"] = tuple(prior["centre_of_mass"])
    outline = Polygon(schema.object.outline, schema.object.holes)
    obj = GridObject(
        schema.object.name, np.array(cells.p_BC), schema.object.cell_size, np.array(cells.labels), outline,
        PhysicalPrior(**prior),
    )  # fmt: skip
    params = CellParameters(np.array(cells.mass), np.array(cells.friction), schema.contact_friction)
    posterior = Posterior(
        np.array(schema.posterior.mean),
        unpack_symmetric("posterior.covariance", schema.posterior.covariance, n + 1),
        unpack_symmetric("posterior.prior_covariance", schema.posterior.prior_covariance, n + 1),
    )
    return Identification(
        obj=obj,
        params=params,
        std=CellParameters(np.array(cells.mass_std), np.array(cells.friction_std), schema.contact_friction_std),
        posterior=posterior,
        identifiability=calc_identifiability(obj, params, posterior),
        method=schema.method,
        regime=schema.regime,
        status=schema.status,
        message=schema.message,
        history=tuple(HistoryEntry(*entry) for entry in schema.history),
        simulations=schema.simulations,
        noise_std=schema.noise_std,
        seed=schema.seed,
        push_names=tuple(schema.training_pushes),
        unused_pushes=tuple(schema.unused_pushes),
    )  # fmt: skip


class _Dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]
    """Lists on one line, text of several lines as it stands."""


def _represent_list(dumper: Any, value: list[Any]) -> Any:
    return dumper.represent_sequence("tag:yaml.org,2002:seq", value, flow_style=True)


def _represent_text(dumper: Any, value: str) -> Any:
    return dumper.represent_scalar("tag:yaml.org,2002:str", value, style="|" if "\n" in value else None)


_Dumper.add_representer(list, _represent_list)
_Dumper.add_representer(tuple, _represent_list)
_Dumper.add_representer(str, _represent_text)
