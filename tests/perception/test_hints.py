import cv2
import numpy as np
import pytest
from shapely import Polygon

from gridpush_drake.errors import (
    ImageError,
    MultipleObjectsError,
    NoObjectError,
    ObjectAtBorderError,
    PerceptionError,
)
from gridpush_drake.geometry.se2 import transform
from gridpush_drake.perception import Camera, DetectorOptions, ObjectHint, detect_object, read_mask
from tests.helpers.pictures import calc_outline_error, cover, make_camera, paint

L_SHAPE = np.array([[0, 0], [0.14, 0], [0.14, 0.04], [0.05, 0.04], [0.05, 0.12], [0, 0.12]]) - [
    0.05,
    0.04,
]
SQUARE = 0.03 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
POSE, ASIDE = (0.02, 0.01, 0.3), (-0.16, 0.1, 0.2)
HEIGHT, BROWN = 0.02, (150, 120, 80)
DISTORTION = (-0.12, 0.05, 0.001, -0.002, 0.0)


def find_box(camera, outline, pose, room=10):
    """Left, top, right, bottom of an object in the picture as it is taken, with some room."""
    points = np.column_stack([transform(pose, outline), np.zeros(len(outline))])
    seen = camera.project(points)
    return (*(seen.min(axis=0) - room), *(seen.max(axis=0) + room))


def look(hint, prisms, camera=None, **painting):
    camera = camera or make_camera()
    frame = paint(camera, prisms, **painting)
    options = DetectorOptions(height=HEIGHT, hint=hint)
    return detect_object(frame.color, frame.depth, camera, options)


TWO = [(L_SHAPE, POSE, HEIGHT, BROWN), (SQUARE, ASIDE, HEIGHT, (60, 90, 150))]


@pytest.mark.slow
def test_a_click_chooses_among_several():
    with pytest.raises(MultipleObjectsError):
        look(None, TWO)
    camera = make_camera()
    for outline, pose, *_ in TWO:
        x, y = camera.project([*transform(pose, np.array([[0.01, -0.02]]))[0], 0.0])
        found = look(ObjectHint(click=(x, y)), TWO)
        assert calc_outline_error(found.outline, Polygon(transform(pose, outline))) < 6e-4


@pytest.mark.slow
def test_a_box_chooses_among_several():
    for outline, pose, *_ in TWO:
        found = look(ObjectHint(box=find_box(make_camera(), outline, pose)), TWO)
        assert calc_outline_error(found.outline, Polygon(transform(pose, outline))) < 6e-4


def test_an_object_that_seems_torn():
    """Two stripes across a brown object have the table's own color; by height nothing is told."""
    camera = make_camera()
    frame = paint(camera, [(L_SHAPE, POSE, HEIGHT, BROWN)], depth=False)
    bare = paint(camera, [], depth=False, seed=1)
    color = frame.color.copy()
    for low, high in ((0.02, 0.026), (0.06, 0.066)):
        stripe = np.array([[low, -0.1], [high, -0.1], [high, 0.2], [low, 0.2]])
        hidden = cover(camera, stripe, POSE, 0.0) > 0.5
        color[hidden] = bare.color[hidden]
    true = Polygon(transform(POSE, L_SHAPE))

    def find(hint):
        return detect_object(color, None, camera, DetectorOptions(height=HEIGHT, hint=hint))

    with pytest.raises(MultipleObjectsError):
        find(None)
    found = find(ObjectHint(box=find_box(camera, L_SHAPE, POSE)))
    assert calc_outline_error(found.outline, true) < 1e-3


@pytest.mark.slow
def test_a_mask_is_taken_as_it_is():
    camera = make_camera()
    mask = cover(camera, L_SHAPE, POSE, HEIGHT) > 0.5
    found = look(ObjectHint(mask=mask), [], depth=False)  # nothing is to be seen
    np.testing.assert_array_equal(found.mask, mask)
    assert calc_outline_error(found.outline, Polygon(transform(POSE, L_SHAPE))) < 6e-4
    speck = mask.copy()
    speck[5:9, 5:9] = True
    np.testing.assert_array_equal(look(ObjectHint(mask=speck), []).mask, mask)
    two = mask | (cover(camera, SQUARE, ASIDE, HEIGHT) > 0.5)
    with pytest.raises(PerceptionError, match=r"pieces of \d+ and \d+ pixels; expected one object"):
        look(ObjectHint(mask=two), [])
    with pytest.raises(NoObjectError, match="the mask has 16 pixels that are not 0"):
        look(ObjectHint(mask=speck & ~mask), [])


@pytest.mark.parametrize("kind", ["mask", "box", "click"])
def test_hints_are_in_the_photograph_as_it_was_taken(kind):
    plain = make_camera()
    camera = Camera(plain.width, plain.height, plain.K, DISTORTION, plain.X_WC)
    pose = (0.17, 0.11, 0.3)  # where the lens bends by several pixels
    frame = paint(plain, [(L_SHAPE, pose, HEIGHT, BROWN), TWO[1]])
    # The picture as the bent lens takes it: each of its pixels looks along its own ray.
    rows, columns = np.mgrid[0 : plain.height, 0 : plain.width]
    rays = camera.rays(np.stack([columns, rows], -1).astype(float))
    flat = rays[..., :2] / rays[..., 2:]
    at = (flat * plain.K[[0, 1], [0, 1]] + plain.K[:2, 2]).astype(np.float32)
    taken = cv2.remap(frame.color, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=1)
    mask = cv2.remap(
        cover(plain, L_SHAPE, pose, HEIGHT).astype(np.float32), at[..., 0], at[..., 1], 1
    )
    middle = camera.project([*transform(pose, np.array([[0.02, -0.02]]))[0], HEIGHT])
    hint = {
        "mask": ObjectHint(mask=mask > 0.5),
        "box": ObjectHint(box=find_box(camera, L_SHAPE, pose)),
        "click": ObjectHint(click=tuple(middle)),
    }[kind]
    options = DetectorOptions(height=HEIGHT, hint=hint)
    found = detect_object(taken, None, camera, options)
    assert calc_outline_error(found.outline, Polygon(transform(pose, L_SHAPE))) < 1e-3


@pytest.mark.slow
def test_hints_that_do_not_help():
    with pytest.raises(NoObjectError, match="nothing stands out from the table where the click is"):
        look(ObjectHint(click=(600, 30)), TWO)
    with pytest.raises(PerceptionError, match="click is 700,30; expected a pixel of the picture"):
        look(ObjectHint(click=(700, 30)), TWO)
    with pytest.raises(PerceptionError, match="outside the picture"):
        look(ObjectHint(box=(700, 10, 800, 90)), TWO)
    with pytest.raises(ImageError, match="the mask has 20x10 pixels"):
        look(ObjectHint(mask=np.ones((10, 20), dtype=bool)), TWO)
    with pytest.raises(ObjectAtBorderError):
        look(ObjectHint(mask=np.ones((480, 640), dtype=bool)), TWO)
    with pytest.raises(PerceptionError, match="box is 50,10,52,90; expected left,top,right,bottom"):
        ObjectHint(box=(50, 10, 52, 90))
    with pytest.raises(PerceptionError, match="several are given; expected one"):
        ObjectHint(box=(0, 0, 50, 50), click=(1, 1))


def test_masks_of_any_kind(tmp_path):
    camera = make_camera()
    mask = cover(camera, SQUARE, POSE, 0.0) > 0.5
    kinds = {
        "bool.png": mask.astype(np.uint8),
        "gray.png": 255 * mask.astype(np.uint8),
        "deep.png": 7 * mask.astype(np.uint16),
        "color.png": np.dstack([0 * mask, 0 * mask, 200 * mask]).astype(np.uint8),
        "alpha.png": np.dstack([0 * mask, 9 * mask, 0 * mask, 0 * mask + 255]).astype(np.uint8),
    }
    for name, image in kinds.items():
        cv2.imwrite(str(tmp_path / name), image)
        np.testing.assert_array_equal(read_mask(tmp_path / name, camera), mask, err_msg=name)
    cv2.imwrite(str(tmp_path / "small.png"), np.ones((4, 4), np.uint8))
    with pytest.raises(ImageError, match=r"small\.png: .*4x4"):
        read_mask(tmp_path / "small.png", camera)
