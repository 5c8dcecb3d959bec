"""The report's tables of numbers."""

import numpy as np

from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.identification.result import Identification
from gridpush_drake.pushes.log import PushLog

MM = 1e3

Row = tuple[str, str, str]
"""What, its learned value and, where it is known, the true one."""


def list_numbers(result: Identification, truth: CellParameters | None = None) -> list[Row]:
    """The quantities that sum a model up, each with its standard deviation, and the truth where it is known."""
    known = result.identifiability
    rows = [_describe_part(result, label, truth) for label in _parts(result)]
    rows.append(
        (
            "centre of friction",
            _point(
                known.centre_of_friction, np.sqrt(np.maximum(np.diagonal(known.centre_of_friction_covariance), 0.0))
            ),
            "" if truth is None else _point(truth.relative_friction() @ result.obj.p_BC),
        )
    )
    low, high = known.centre_of_mass_box
    rows += [
        (
            "centre of mass, estimate",
            _point(result.params.centre_of_mass(result.obj)),
            "" if truth is None else _point(truth.centre_of_mass(result.obj)),
        ),
        ("centre of mass, possible", f"x {_range(low[0], high[0])}, y {_range(low[1], high[1])}", ""),
        (
            "contact friction",
            f"{result.params.contact_friction:.2f} ± {result.std.contact_friction:.2f}",
            "" if truth is None else f"{truth.contact_friction:.2f}",
        ),
        (
            "total mass",
            f"{result.params.total_mass:.3g} kg" + ("" if result.obj.prior.total_mass else ", assumed"),
            "" if truth is None else f"{truth.total_mass:.3g} kg",
        ),
        ("left unexplained", f"{result.noise_std * MM:.2f} mm per axis", ""),
    ]
    return rows


def describe_making(result: Identification, log: PushLog, version: str) -> list[tuple[str, str]]:
    """How the model was made."""
    return [
        ("object", f"{result.obj.name}, {result.obj.n} cells of {result.obj.cell_size * MM:.1f} mm"),
        ("pushes", log.source or "given in memory"),
        ("method", result.method),
        ("physics", result.regime.replace("_", "-")),
        ("status", result.status.replace("_", " ")),
        ("simulated pushes", str(result.simulations)),
        ("seed", str(result.seed)),
        ("gridpush-drake", version),
    ]


def _parts(result: Identification) -> list[int]:
    labels = np.unique(result.obj.labels)
    return labels.tolist() if len(labels) > 1 else []


def _describe_part(result: Identification, label: int, truth: CellParameters | None) -> Row:
    """The share of the support's friction that a part carries."""
    part = (result.obj.labels == label).astype(np.float64)
    share = result.identifiability.relative_friction @ part
    spread = np.sqrt(max(part @ result.posterior.calc_share_covariance() @ part, 0.0))
    true = "" if truth is None else f"{truth.relative_friction() @ part * 100:.0f} %"
    return f"friction carried by part {label}", f"{share * 100:.0f} ± {spread * 100:.0f} %", true


def _point(point: np.ndarray, spread: np.ndarray | None = None) -> str:
    if spread is None:
        return f"({point[0] * MM:.1f}, {point[1] * MM:.1f}) mm"
    x, y = (f"{value * MM:.1f} ± {std * MM:.1f}" for value, std in zip(point, spread, strict=True))
    return f"({x}, {y}) mm"


def _range(low: float, high: float) -> str:
    return f"{low * MM:.0f} to {high * MM:.0f} mm" if np.isfinite([low, high]).all() else "not bounded"
