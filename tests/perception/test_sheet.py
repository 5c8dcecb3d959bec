"""An object beside or on a sheet of paper, in a photograph whose camera may be unknown."""

import cv2
import numpy as np
import pytest
import shapely
from PIL import ExifTags, Image
from shapely import Polygon

from gridpush_drake.errors import (
    CameraError,
    MultipleObjectsError,
    NoObjectError,
    SheetError,
)
from gridpush_drake.geometry.se2 import transform
from gridpush_drake.perception import (
    SHEET_SIZES,
    DetectorOptions,
    ObjectHint,
    detect_by_sheet,
    find_sheet,
    read_focal_length,
)
from gridpush_drake.perception.calibration.sheet import list_corners
from tests.helpers.pictures import calc_outline_error, make_camera, paint

PAPER = (235, 233, 228)
TABLE = (120, 100, 85)
BLUE = (60, 90, 150)

BLOCK = np.array(
    [[-0.05, -0.03], [0.05, -0.03], [0.05, 0.0], [0.01, 0.0], [0.01, 0.04], [-0.05, 0.04]]
)
"""Corners of what is photographed, m. No turn brings it onto itself."""

HEIGHT = 0.02
"""Its height, m."""

SHEET_POSE = (-0.1, 0.02, 0.3)
BESIDE = (0.13, 0.02, 0.4)
ON_SHEET = (-0.09, 0.02, 0.9)
"""Where sheet and block lie, m and rad, in the world of the camera that paints."""

FOCAL = 750.0
"""Focal length of that camera, pixels."""

ABOVE = {"rpy": (180, 0, 0), "distance": 0.7}
SLANTED = {"rpy": (210, 0, 0), "at": (0.0, -0.35), "distance": 0.6}
"""Where it is: straight above, or at a slant of 30 degrees."""

WHITE = 150
"""Least of a pixel's colors on paper, in the shade, too; the table's blue is darker."""

MIN_PAPER = 20_000
"""Least number of pixels of the paper in any of the pictures."""

MAX_ERROR = 3e-4
"""Largest mean distance of an outline from the true one, m; a pixel shows 0.9 mm."""


def photograph(prisms, view=SLANTED, seed=0, table=TABLE, shadow=0.0, distortion=()):
    """Takes a photograph of prisms on a table; returns it with the camera that took it."""
    camera = make_camera(960, 720, FOCAL, distortion=distortion, **view)
    color = paint(camera, prisms, seed, table=table, depth=False, shadow=shadow).color
    return color, camera


def lay(pose=SHEET_POSE, size="a4"):
    """A sheet as a prism of no height."""
    return list_corners(SHEET_SIZES[size])[:, :2], pose, 0.0, PAPER


def block(pose):
    """The block as a prism."""
    return BLOCK, pose, HEIGHT, BLUE


def calc_error(outline_B):
    """How far an outline is from the block's on average, turned as it fits best, m."""
    middle = Polygon(BLOCK).centroid
    true = shapely.affinity.translate(Polygon(BLOCK), -middle.x, -middle.y)
    turns = np.linspace(0, 360, 181)
    turned = (shapely.affinity.rotate(outline_B, turn, origin=(0, 0)) for turn in turns)
    return min(calc_outline_error(each, true) for each in turned)


@pytest.mark.parametrize("knows_camera", [True, False], ids=["known camera", "unknown camera"])
@pytest.mark.parametrize("pose", [BESIDE, ON_SHEET], ids=["beside", "on"])
def test_an_outline_is_metric_beside_and_on_a_sheet(pose, knows_camera):
    color, camera = photograph([lay(), block(pose)], shadow=0.2)
    sheet = find_sheet(color, SHEET_SIZES["a4"], camera if knows_camera else None)
    assert sheet.focal_known
    assert sheet.camera.K[0, 0] == pytest.approx(FOCAL, rel=0.01)
    assert sheet.camera.center[2] == pytest.approx(SLANTED["distance"], rel=0.01)
    by_sheet = detect_by_sheet(color, sheet, DetectorOptions(height=HEIGHT))
    assert by_sheet.on_sheet == (pose is ON_SHEET)
    error = calc_error(by_sheet.found.outline_B)
    print(f"mean distance of the outline {1e3 * error:.3f} mm")
    assert error < MAX_ERROR
    # The pixel is where the middle of the block is in the photograph as it was taken
    middle = Polygon(transform(pose, BLOCK)).centroid
    true_pixel = camera.project([middle.x, middle.y, 0.0])
    np.testing.assert_allclose(by_sheet.pixel, true_pixel, atol=1.0)
    # and what is shown of it has the paper as it was photographed, not painted over
    assert (by_sheet.found.picture.min(axis=-1) > WHITE).sum() > MIN_PAPER


def test_a_letter_is_no_a4():
    color, _ = photograph([lay(size="letter"), block(BESIDE)])
    sheet = find_sheet(color, SHEET_SIZES["letter"])
    by_sheet = detect_by_sheet(color, sheet, DetectorOptions(height=HEIGHT))
    assert calc_error(by_sheet.found.outline_B) < MAX_ERROR
    with pytest.raises(SheetError, match=r"no sheet of 297 x 210 mm.*may be letter"):
        find_sheet(color, SHEET_SIZES["a4"])


def test_a_lens_that_bends_lines_is_no_matter_where_it_is_known():
    color, camera = photograph([lay(), block(BESIDE)], distortion=(-0.12, 0.05, 0, 0))
    sheet = find_sheet(color, SHEET_SIZES["a4"], camera)
    by_sheet = detect_by_sheet(color, sheet, DetectorOptions(height=HEIGHT))
    assert calc_error(by_sheet.found.outline_B) < MAX_ERROR


def test_from_straight_above_the_focal_length_must_be_told_for_what_has_a_height():
    color, _ = photograph([lay(), block(BESIDE)], ABOVE)
    blind = find_sheet(color, SHEET_SIZES["a4"])
    assert not blind.focal_known
    with pytest.raises(CameraError, match=r"focal length.*slant of 20 to 50 degrees"):
        detect_by_sheet(color, blind, DetectorOptions(height=HEIGHT))
    told = find_sheet(color, SHEET_SIZES["a4"], focal=FOCAL)
    assert told.focal_known
    by_sheet = detect_by_sheet(color, told, DetectorOptions(height=HEIGHT))
    assert calc_error(by_sheet.found.outline_B) < MAX_ERROR


def test_what_is_flat_needs_no_focal_length():
    card = (BLOCK, BESIDE, 0.0, BLUE)
    color, _ = photograph([lay(), card], ABOVE)
    by_sheet = detect_by_sheet(color, find_sheet(color, SHEET_SIZES["a4"]))
    assert calc_error(by_sheet.found.outline_B) < MAX_ERROR


@pytest.mark.parametrize(
    ("prisms", "why"),
    [
        ([block(BESIDE)], "no sheet"),
        ([lay((-0.1, 0.02, 1.4)), lay((0.16, 0.02, 1.5)), block((0.0, 0.25, 0.0))], "2 sheets"),
        ([lay(), block((0.0, 0.05, 0.9))], "no sheet"),
        ([lay((-0.35, 0.02, 0.3)), block(BESIDE)], "no sheet"),
    ],
    ids=["none", "two", "the object lies over its edge", "a corner is out of view"],
)
def test_refuses_what_does_not_tell_the_scale(prisms, why):
    color, _ = photograph(prisms)
    with pytest.raises(SheetError, match=why) as refused:
        find_sheet(color, SHEET_SIZES["a4"])
    assert refused.value.picture.shape == color.shape


def test_a_sheet_alone_is_no_object_and_a_click_chooses_one_of_two():
    color, camera = photograph([lay()])
    with pytest.raises(NoObjectError):
        detect_by_sheet(color, find_sheet(color, SHEET_SIZES["a4"]))
    other = (-0.16, 0.0, 0.3)
    small = (0.3 * BLOCK, other, HEIGHT, (150, 60, 60))
    color, camera = photograph([lay(), block((-0.05, 0.03, 0.9)), small])
    sheet = find_sheet(color, SHEET_SIZES["a4"])
    with pytest.raises(MultipleObjectsError):
        detect_by_sheet(color, sheet, DetectorOptions(height=HEIGHT))
    x, y = camera.project([-0.05, 0.03, HEIGHT])
    hint = ObjectHint(click=(x - 8, y))
    by_sheet = detect_by_sheet(color, sheet, DetectorOptions(height=HEIGHT, hint=hint))
    assert calc_error(by_sheet.found.outline_B) < MAX_ERROR
    # A box, and a mask, are moved to the view from above, too
    corners = camera.project(np.column_stack([transform((-0.05, 0.03, 0.9), BLOCK), np.zeros(6)]))
    tops = camera.project(
        np.column_stack([transform((-0.05, 0.03, 0.9), BLOCK), np.full(6, HEIGHT)])
    )
    drawn = np.zeros(color.shape[:2], np.uint8)
    hull = cv2.convexHull(np.round([*corners, *tops]).astype(np.int32))
    cv2.fillConvexPoly(drawn, hull, 1)
    hint = ObjectHint(mask=drawn > 0)
    by_mask = detect_by_sheet(color, sheet, DetectorOptions(height=HEIGHT, hint=hint))
    assert by_mask.found.outline.centroid.distance(by_sheet.found.outline.centroid) < 0.01


def test_a_phones_focal_length_is_read(tmp_path):
    picture = Image.new("RGB", (400, 300))
    exif = Image.Exif()
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = 26
    told = tmp_path / "phone.jpg"
    picture.save(told, exif=exif)
    assert read_focal_length(told) == pytest.approx(26 / 43.267 * 500)
    silent = tmp_path / "silent.png"
    picture.save(silent)
    assert read_focal_length(silent) is None
    assert read_focal_length(tmp_path / "none.jpg") is None
