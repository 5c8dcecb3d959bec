"""Several objects in one photograph: each found by itself, hands left out, touching ones doubted."""

import numpy as np
import pytest
from shapely import Polygon

from gridpush_drake.errors import NoObjectError, ObjectAtBorderError, PerceptionError
from gridpush_drake.geometry.se2 import transform
from gridpush_drake.perception import DetectorOptions, ObjectHint, detect_object, detect_objects
from tests.helpers.pictures import calc_outline_error, make_camera, paint

L_SHAPE = np.array([[0, 0], [0.14, 0], [0.14, 0.04], [0.05, 0.04], [0.05, 0.12], [0, 0.12]]) - [
    0.05,
    0.04,
]
BLOCK = np.array([[-0.03, -0.02], [0.03, -0.02], [0.03, 0.02], [-0.03, 0.02]])
WEDGE = np.array([[-0.05, -0.03], [0.05, -0.03], [0.02, 0.03]])
HAND = np.array([[-0.02, -0.12], [0.02, -0.12], [0.02, 0.12], [-0.02, 0.12]])
HEIGHT, LOW = 0.03, 0.012
BROWN, BLUE, DARK, SKIN = (150, 120, 80), (70, 80, 140), (60, 60, 62), (200, 150, 120)

WHERE = {"elbow": (-0.15, -0.03, 0.3), "block": (0.02, 0.1, 0.7), "wedge": (0.14, -0.06, 2.0)}
PRISMS = [
    (L_SHAPE, WHERE["elbow"], HEIGHT, BROWN),
    (BLOCK, WHERE["block"], LOW, BLUE),
    (WEDGE, WHERE["wedge"], HEIGHT, DARK),
]


def detect(prisms, options=None, depth=True, **painting):
    frame = paint(make_camera(), prisms, depth=depth, **painting)
    return detect_objects(frame.color, frame.depth, make_camera(), options)


def test_each_is_found_with_a_height_of_its_own_from_left_to_right():
    found = detect(PRISMS, shadow=0.2)
    assert found.cut == 0
    assert len(found.objects) == 3
    for each, (outline, pose, height, _) in zip(found.objects, PRISMS, strict=True):
        true = Polygon(transform(pose, outline))
        assert calc_outline_error(each.outline, true) < 6e-4
        assert abs(each.height - height) < 0.0015
        assert not each.doubtful
        assert not each.crowded
    assert found.picture.shape == (480, 640, 3)
    masks = sum(each.mask.astype(int) for each in found.objects)
    assert masks.max() == 1


@pytest.mark.slow
def test_one_object_is_found_as_by_itself():
    frame = paint(make_camera(), PRISMS[:1])
    alone = detect_object(frame.color, frame.depth, make_camera())
    (found,) = detect_objects(frame.color, frame.depth, make_camera()).objects
    assert calc_outline_error(found.outline, alone.outline) < 1e-4
    assert found.height == alone.height


@pytest.mark.parametrize("depth", [True, False], ids=["depth", "color"])
def test_a_hand_that_reaches_in_is_no_object(depth):
    hand = (HAND, (0.1, 0.2, 0.1), 0.05, SKIN)
    options = None if depth else DetectorOptions(height=HEIGHT)
    found = detect([*PRISMS[:2], hand], options, depth)
    assert found.cut == 1
    assert len(found.objects) == 2
    with pytest.raises(ObjectAtBorderError, match="everything in view touches"):
        detect([hand], options, depth)


@pytest.mark.slow
def test_objects_that_touch_are_doubted_and_a_tool_of_one_color_is_not():
    # a block of another color against the L's foot, not flush with it
    touching = [
        (L_SHAPE, (-0.08, 0.0, 0.0), HEIGHT, BROWN),
        (BLOCK, (0.04, -0.045, 0.3), HEIGHT, BLUE),
    ]
    (found,) = detect(touching).objects
    assert found.crowded
    # as high as each other and of one color, but one of them is lower
    lower = [(L_SHAPE, (-0.08, 0.0, 0.0), HEIGHT, BROWN), (BLOCK, (0.04, -0.045, 0.3), LOW, BROWN)]
    (found,) = detect(lower).objects
    assert found.crowded
    hammer = np.array(
        [[-0.1, -0.01], [0.05, -0.01], [0.05, -0.05], [0.09, -0.05], [0.09, 0.05], [0.05, 0.05],
         [0.05, 0.01], [-0.1, 0.01]]
    )  # fmt: skip
    (found,) = detect([(hammer, (0.0, 0.0, 0.3), HEIGHT, BROWN)]).objects
    assert not found.crowded


def test_what_is_wrong_is_said():
    with pytest.raises(NoObjectError, match="no object is in view"):
        detect([])
    with pytest.raises(PerceptionError, match="hint: is given"):
        detect(PRISMS, DetectorOptions(hint=ObjectHint(click=(300, 200))))
    with pytest.raises(PerceptionError, match="height is -1"):
        detect(PRISMS, DetectorOptions(height=-1.0))
