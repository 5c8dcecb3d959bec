"""How well the outlines of shipped objects are found, for `gridpush bench perception`.

The objects are rendered from straight above, see `rendered_table`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import Polygon

from gridpush_drake.bench.perception.rendered_table import (
    FOCAL_LENGTH,
    OBJECT_COLORS,
    OBJECT_HEIGHT,
    RenderedTable,
    load_object,
    make_overhead_camera,
)
from gridpush_drake.errors import PerceptionError
from gridpush_drake.geometry.se2 import transform
from gridpush_drake.perception import (
    detect_object,
)
from gridpush_drake.report.table import ALL_RESULTS, Table, Value
from gridpush_drake.units import MM_PER_M, PERCENT_PER_ONE

CAMERA_HEIGHT = 0.6
"""Height of the camera over the table where outlines are found, m."""

MAX_SHIFT = 0.03
"""Greatest distance of an object from the middle of the picture along x and y, m."""

MAX_TILT = 3.0
"""Greatest tilt of the camera about each axis, degrees."""

COMPARED_POINTS = 400
"""Number of points of an outline whose distance to the other one is taken."""


@dataclass(frozen=True)
class OutlineJob:
    """One object at several poses.

    Attributes:
        name: name of the object.
        poses: number of poses.
        seed: seed of everything random.
    """

    name: str
    poses: int
    seed: int


@dataclass(frozen=True)
class OutlineScore:
    """What was found of one object.

    Attributes:
        name: name of the object.
        errors: mean distance between the outlines at each pose, m; NaN where none was found.
        areas: relative error of the outline's area at each pose where one was found.
        heights: error of the height at each pose where an outline was found, m.
    """

    name: str
    errors: list[float]
    areas: list[float]
    heights: list[float]


def run_outline(job: OutlineJob) -> OutlineScore:
    """Renders an object at random poses and finds it."""
    obj = load_object(job.name)
    rng = np.random.default_rng((job.seed, 1))
    score = OutlineScore(name=job.name, errors=[], areas=[], heights=[])
    for k in range(job.poses):
        camera = make_overhead_camera(CAMERA_HEIGHT, rng.uniform(-MAX_TILT, MAX_TILT, 2))
        table = RenderedTable(
            obj.outline, OBJECT_HEIGHT, OBJECT_COLORS[k % len(OBJECT_COLORS)], camera
        )
        middle = camera.cast(camera.K[:2, 2])
        pose = np.array([*rng.uniform(-MAX_SHIFT, MAX_SHIFT, 2), rng.uniform(-np.pi, np.pi)])
        # the outline, and not the body frame's origin, is to be near the middle of the picture
        center = obj.outline.envelope.centroid.coords[0]
        pose[:2] += middle - transform([0, 0, pose[2]], [center])[0]
        frame, _ = table.look(pose, seed=job.seed + k)
        true = shapely.transform(obj.outline, lambda points, pose=pose: transform(pose, points))
        try:
            found = detect_object(frame.color, frame.depth, camera)
        except PerceptionError:
            score.errors.append(float("nan"))
            continue
        score.errors.append(calc_outline_error(found.outline, true))
        score.areas.append(float(found.outline.area / true.area - 1))
        score.heights.append(found.height - OBJECT_HEIGHT)
    return score


def calc_outline_error(a: Polygon, b: Polygon) -> float:
    """Calculates the mean distance between two outlines, holes included, both ways, m."""
    return (_calc_distance(a, b) + _calc_distance(b, a)) / 2


def _calc_distance(a: Polygon, b: Polygon) -> float:
    """Calculates the mean distance of points of one outline from the other outline, m."""
    boundary = a.boundary
    points = shapely.line_interpolate_point(
        boundary, np.linspace(0, boundary.length, COMPARED_POINTS, endpoint=False)
    )
    return float(shapely.distance(points, b.boundary).mean())


def tabulate_outlines(scores: Sequence[OutlineScore]) -> Table:
    """Makes a row for each object, and one of all."""

    def make_row(name: str, some: Sequence[OutlineScore]) -> tuple[Value, ...]:
        errors, areas, heights = (
            np.concatenate([getattr(score, key) for score in some])
            for key in ("errors", "areas", "heights")
        )
        found = errors[np.isfinite(errors)]
        return (
            name,
            len(errors),
            len(errors) - len(found),
            *(MM_PER_M * _calc_mean_and_worst(found)),
            PERCENT_PER_ONE * float(np.mean(areas)),
            PERCENT_PER_ONE * float(np.abs(areas).max(initial=0.0)),
            MM_PER_M * float(np.abs(heights).max(initial=0.0)),
        )

    rows = [make_row(score.name, [score]) for score in scores] + [make_row(ALL_RESULTS, scores)]
    columns = (
        "object",
        "poses",
        "not found",
        "outline, mean, mm",
        "outline, worst, mm",
        "area, mean, %",
        "area, worst, %",
        "height, worst, mm",
    )
    notes = [
        f"Rendered from {CAMERA_HEIGHT} m, {FOCAL_LENGTH:g} pixels of focal length, with shadows, "
        "a depth "
        f"camera's noise and holes; objects {OBJECT_HEIGHT * MM_PER_M:g} mm high, in "
        f"{len(OBJECT_COLORS)} colors.",
        "outline: mean distance between the found one and the true one; area: of what it encloses.",
    ]
    return Table("Outline of objects from one photograph", columns, rows, notes)


def _calc_mean_and_worst(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Calculates mean and greatest of some values (2,); NaN where there are none."""
    if not len(values):
        return np.full(2, np.nan)
    return np.array([values.mean(), values.max()])
