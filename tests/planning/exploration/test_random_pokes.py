"""Which random pokes are proposed."""

import numpy as np
import pytest
from shapely import LineString, Point, Polygon, box
from shapely.affinity import affine_transform

from gridpush_drake.errors import PushError
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.planning.exploration import PokeRegion, RandomPokeOptions, RandomPokes
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.support_surface import SupportSurface
from tests.helpers.shapes import make_shape

REGION = PokeRegion(keep_in=box(-0.35, -0.35, 0.35, 0.35))
WORKSPACE = box(-0.5, -0.5, 0.5, 0.5)
RULES = PushConstraints(finger_region=WORKSPACE)
OPTIONS = RandomPokeOptions()
POSE = np.array([0.1, -0.05, 0.7])


def propose(obj: GridObject, number: int = 1, seed: int = 0, pose=POSE, region=REGION, rules=RULES):
    return RandomPokes(OPTIONS, region, seed, number).propose(Model(obj), pose, rules)


def draw(obj: GridObject, pose, number: int, seed: int, attempt: int, options=OPTIONS):
    return RandomPokes(options, seed=seed, number=number).draw(obj, np.asarray(pose), attempt)


def predict_end(obj: GridObject, pose, poke):
    return RandomPokes(OPTIONS).predict(Model(obj), pose, poke)[-1]


def place(obj: GridObject, pose) -> Polygon:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return affine_transform(obj.outline, [c, -s, s, c, pose[0], pose[1]])


@pytest.mark.parametrize("name", ["claw_hammer", "pliers", "toolbox"])
def test_proposed_pokes_fit_and_stay_in_bounds(name):
    obj = GridObject.from_yaml(find_shipped_object(name))
    for number in range(1, 9):
        poke = propose(obj, number).push
        gap = place(obj, POSE).distance(Point(poke.start)) - OPTIONS.tip_radius
        assert gap == pytest.approx(OPTIONS.clearance, rel=1e-4)
        assert poke.length / poke.duration == pytest.approx(OPTIONS.speed)
        assert OPTIONS.distance[0] <= poke.length - OPTIONS.clearance <= OPTIONS.distance[1]
        assert WORKSPACE.contains(LineString(poke.xy))
        last = predict_end(obj, POSE, poke)
        assert REGION.keep_in.contains(place(obj, last))
        moved = np.linalg.norm(obj.cells_at(last) - obj.cells_at(POSE), axis=1).mean()
        assert moved >= OPTIONS.min_motion


def test_draw_depends_on_seed_number_and_attempt_alone():
    obj = make_shape("claw_hammer", 40)
    one = draw(obj, POSE, 3, 5, 7)
    propose(obj, 1), propose(obj, 2, seed=5)
    np.testing.assert_array_equal(draw(obj, POSE, 3, 5, 7).xy, one.xy)
    others = [draw(obj, POSE, *key) for key in ((4, 5, 7), (3, 6, 7), (3, 5, 8))]
    assert len({tuple(other.start) for other in (one, *others)}) == 4
    found = propose(obj, 3, 5)
    again = draw(obj, POSE, 3, 5, found.candidates - 1)
    np.testing.assert_array_equal(found.push.xy, again.xy)


def test_pokes_go_inwards_within_the_slant():
    obj = make_shape("square", 25)
    slants = []
    for attempt in range(200):
        poke = draw(obj, np.zeros(3), 1, 0, attempt)
        nearest = np.clip(poke.start, -0.05, 0.05)
        inward = (nearest - poke.start) / np.linalg.norm(nearest - poke.start)
        along = poke.velocity / np.linalg.norm(poke.velocity)
        slants.append(np.arccos(np.clip(inward @ along, -1, 1)))
    assert max(slants) <= OPTIONS.slant + 1e-9 and max(slants) > 0.8 * OPTIONS.slant


def test_notch_narrower_than_the_tip_is_left_alone():
    """A U with a slot of 2 cm between arms: a tip of 8 mm radius with 8 mm clearance does not fit, one of 2 mm does."""
    slot = box(-0.01, -0.01, 0.01, 0.06)
    obj = GridObject.from_outline(box(-0.05, -0.05, 0.05, 0.05).difference(slot), max_cells=40)
    starts = []
    for options in (OPTIONS, RandomPokeOptions(tip_radius=0.002, clearance=0.002)):
        strategy = RandomPokes(options)
        drawn = [strategy.draw(obj, np.zeros(3), attempt) for attempt in range(300)]
        fitting = [poke for poke in drawn if strategy.fits(obj, np.zeros(3), poke, RULES)]
        starts.append([poke.start for poke in fitting])
    assert not any(slot.contains(Point(start)) for start in starts[0])
    assert any(slot.contains(Point(start)) for start in starts[1])


def test_rules_are_kept():
    obj = make_shape("square", 25)
    left = PushConstraints(finger_region=box(-1, -1, 0, 1))
    above = PushConstraints(finger_region=WORKSPACE, push_rule=lambda poke: poke.start[1] > 0)
    table = PushConstraints(SupportSurface.rectangle((-0.02, 0.0), (0.2, 0.4)))
    for number in range(1, 6):
        poke = propose(obj, number, pose=np.zeros(3), rules=left).push
        assert poke.xy[:, 0].max() <= 0
        assert propose(obj, number, pose=np.zeros(3), rules=above).push.start[1] > 0
        # without a region of its own a strategy still keeps the object on the table
        poke = propose(obj, number, pose=np.zeros(3), region=None, rules=table).push
        assert table.surface.contains_cells(obj, predict_end(obj, np.zeros(3), poke), -1e-3)
    nowhere = propose(obj, rules=PushConstraints(push_rule=lambda poke: False))
    assert nowhere.push is None and nowhere.candidates == OPTIONS.candidates
    assert nowhere.reason == "no poke that was drawn fits"
    assert propose(obj, pose=(3.0, 0.0, 0.0)).push is None, "beyond the workspace"


def test_object_at_the_border_is_pushed_back():
    """Nearly all pokes would take it out; those chosen do not, or at least lead towards the middle."""
    obj = make_shape("square", 25)
    region = PokeRegion(box(-0.2, -0.2, 0.2, 0.2))
    rules = PushConstraints(finger_region=box(-1, -1, 1, 1))
    for number in range(1, 9):
        pose = np.array([0.145, 0.145, 0.0])
        poke = propose(obj, number, pose=pose, region=region, rules=rules).push
        assert region.keep_in.covers(place(obj, predict_end(obj, pose, poke)))
    outside = np.array([0.4, 0.0, 0.0])
    found = propose(obj, pose=outside, region=region, rules=rules)
    last = predict_end(obj, outside, found.push)
    assert found.candidates == OPTIONS.candidates
    assert np.linalg.norm(last[:2]) < np.linalg.norm(outside[:2]) - 0.03


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"distance": (0.0, 0.1)}, "distance"),
        ({"distance": (0.2, 0.1)}, "distance"),
        ({"speed": 0.0}, "speed"),
        ({"slant": 1.6}, "slant"),
        ({"tip_radius": -1.0}, "tip_radius"),
        ({"clearance": -0.001}, "clearance"),
        ({"min_motion": np.nan}, "min_motion"),
        ({"candidates": 0}, "candidates"),
    ],
)
def test_bad_styles_are_refused(options, message):
    with pytest.raises(PushError, match=message):
        RandomPokeOptions(**options)
