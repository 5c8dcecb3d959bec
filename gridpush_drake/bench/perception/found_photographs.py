"""How well objects are found in photographs, real and rendered, for `gridpush bench perception`.

The photographs of generated objects are rendered by `rendered_photographs`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import spearmanr

from gridpush_drake.bench.data.protocol import find_masks
from gridpush_drake.bench.perception.rendered_photographs import HALF_NAMES, Half, take_photograph
from gridpush_drake.bench.perception.rendered_table import (
    FOCAL_LENGTH,
    HEIGHT_PIXELS,
    PICTURE_WIDTH,
)
from gridpush_drake.errors import GridPushError, PerceptionError
from gridpush_drake.perception import (
    Camera,
    DetectorOptions,
    detect_object,
    read_color,
    read_depth,
)
from gridpush_drake.perception.detection.expected_iou import DOUBTFUL_IOU
from gridpush_drake.perception.detection.foreground import Cues
from gridpush_drake.report.table import Table, Value
from gridpush_drake.units import PERCENT_PER_ONE

GOOD_IOU = 0.9
"""Intersection over union from which on an object counts as well found."""

POOR_IOU = 0.8
"""Intersection over union below which an object counts as not found; without a refusal that is a
silent failure."""

WARNING_COLUMNS = ("rank correlation of the expected", "doubted for nothing", "wrongly trusted")
"""Columns about the intersection over union that is expected."""

CUE_NAMES: tuple[Cues, ...] = ("both", "color", "depth")
"""What is looked at in a photograph."""

COLOR_ENDING = "_color.png"
"""Ending of the name of a color picture."""

DEPTH_ENDING = "_depth.png"
"""Ending of the name of a depth picture."""


@dataclass(frozen=True)
class PhotoJob:
    """One photograph.

    Attributes:
        name: what it is called.
        color: file of its colors.
        depth: file of its depths.
        mask: file of the true mask of the object.
    """

    name: str
    color: str
    depth: str
    mask: str


@dataclass(frozen=True)
class RenderedPhotoJob:
    """Some rendered photographs of generated objects.

    Attributes:
        half: "tuning" or "reporting".
        first: number of the first photograph.
        count: number of photographs.
    """

    half: Half
    first: int
    count: int


@dataclass(frozen=True)
class RenderedPhotoScore:
    """How well objects were found in rendered photographs.

    Attributes:
        half: "tuning" or "reporting".
        iou: intersection over union of each mask with the true one; NaN where no object was found
            and the detector says so.
        expected: the intersection over union that the detector expected of each.
    """

    half: Half
    iou: list[float]
    expected: list[float]


@dataclass(frozen=True)
class PhotoScore:
    """How well the object's mask was found in a photograph.

    Attributes:
        name: what the photograph is called.
        iou: intersection of the found mask with the true one over their union, for each of
            CUE_NAMES.
    """

    name: str
    iou: tuple[float, ...]


def find_photographs(data: Path) -> list[PhotoJob]:
    """Finds NAME_color.png, NAME_depth.png and NAME_label.pgm anywhere below a folder.

    Raises:
        GridPushError: there is no such folder, or no such three of one name.
    """
    masks = find_masks(data)
    jobs = []
    for color in sorted(data.rglob(f"*{COLOR_ENDING}")):
        name = color.name.removesuffix(COLOR_ENDING)
        depth = color.with_name(name + DEPTH_ENDING)
        if depth.is_file() and name in masks:
            jobs.append(PhotoJob(name, str(color), str(depth), str(masks[name])))
    if not jobs:
        raise GridPushError(
            f"{data}: holds no NAME{COLOR_ENDING} with NAME{DEPTH_ENDING} and NAME_label.pgm"
        )
    return jobs


def run_photo(job: PhotoJob) -> PhotoScore:
    """Finds the object of a photograph by each of CUE_NAMES."""
    K = [[FOCAL_LENGTH, 0, PICTURE_WIDTH / 2], [0, FOCAL_LENGTH, HEIGHT_PIXELS / 2], [0, 0, 1]]
    camera = Camera(PICTURE_WIDTH, HEIGHT_PIXELS, np.array(K), np.zeros(0))
    color = read_color(job.color, camera)
    depth = read_depth(job.depth, camera)
    true = np.asarray(cv2.imread(job.mask, cv2.IMREAD_UNCHANGED)) > 0
    scores = []
    for cues in CUE_NAMES:
        try:
            mask = detect_object(color, depth, camera, DetectorOptions(cues=cues)).mask
            scores.append(float((mask & true).sum() / (mask | true).sum()))
        except PerceptionError:
            scores.append(0.0)
    return PhotoScore(job.name, tuple(scores))


def run_rendered_photo(job: RenderedPhotoJob) -> RenderedPhotoScore:
    """Renders photographs of generated objects and finds them."""
    iou = []
    expected = []
    for number in range(job.first, job.first + job.count):
        photo = take_photograph(job.half, number)
        try:
            found = detect_object(photo.frame.color, photo.frame.depth, photo.camera)
        except PerceptionError:
            iou.append(float("nan"))
            expected.append(float("nan"))
            continue
        iou.append(float((found.mask & photo.mask).sum() / (found.mask | photo.mask).sum()))
        expected.append(found.expected_iou)
    return RenderedPhotoScore(job.half, iou, expected)


def tabulate_photos(scores: Sequence[PhotoScore]) -> Table:
    """Makes a row for each photograph, and one of their mean."""
    rows: list[tuple[Value, ...]] = [(score.name, *score.iou) for score in scores]
    rows.append(("mean", *np.mean([score.iou for score in scores], axis=0).tolist()))
    notes = [
        "Intersection over union with a mask drawn by hand, which itself would not score above "
        "about 0.97."
    ]
    columns = ("photograph", *CUE_NAMES)
    return Table("The object's mask in real photographs", columns, rows, notes)


def tabulate_rendered_photos(scores: Sequence[RenderedPhotoScore]) -> Table:
    """Makes a row for each half of the rendered photographs."""
    rows: list[tuple[Value, ...]] = []
    for half in HALF_NAMES:
        iou = np.concatenate([score.iou for score in scores if score.half == half] or [[]])
        expected = np.concatenate(
            [score.expected for score in scores if score.half == half] or [[]]
        )
        found = iou[np.isfinite(iou)]
        if not len(found):
            continue
        rows.append(
            (
                half,
                len(iou),
                len(iou) - len(found),
                float(found.mean()),
                PERCENT_PER_ONE * float((found >= GOOD_IOU).sum() / len(iou)),
                PERCENT_PER_ONE * float((found < POOR_IOU).sum() / len(iou)),
                *_count_warnings(iou, expected),
            )
        )
    columns = (
        "half",
        "photographs",
        "refused",
        "mean of those found",
        f"at least {GOOD_IOU}, %",
        f"below {POOR_IOU}, %",
        *WARNING_COLUMNS,
    )
    notes = [
        "Generated outlines of several materials on gray, white, wooden and patterned tables, with "
        "the depth of a stereo camera. The halves have other outlines and other materials.",
        "Intersection over union with the true mask; below: found wrongly, without a refusal.",
    ]
    return Table("The object's mask in rendered photographs", columns, rows, notes)


def _count_warnings(iou: ArrayLike, expected: ArrayLike) -> tuple[Value, ...]:
    """Counts how well the expected intersection over union tells the true one.

    Returns:
        Their rank correlation, and the numbers of good outlines that were doubted and of others
        that were not.
    """
    true = np.asarray(iou, dtype=np.float64)
    said = np.asarray(expected, dtype=np.float64)
    found = np.isfinite(true) & np.isfinite(said)
    true = true[found]
    said = said[found]
    rank = float(spearmanr(true, said)[0]) if len(true) > 1 else np.nan
    good = true >= GOOD_IOU
    trusted = said >= DOUBTFUL_IOU
    return rank, int((good & ~trusted).sum()), int((~good & trusted).sum())
