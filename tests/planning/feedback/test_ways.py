"""How a finger gets round an object without touching it."""

import numpy as np
import pytest
from shapely import LineString

from gridpush_drake.dynamics.kernels.contact.walk_round import find_way
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.planning.feedback.ways import DISC_CLEARANCE, NEAR_GAP, make_outline_path

RADIUS = 0.008
STEP = 0.02
OBJECTS = ("toolbox", "claw_hammer", "combination_wrench", "spray_bottle")


def make_outline_paths(name):
    obj = GridObject.from_yaml(find_shipped_object(name))
    return obj, make_outline_path(obj.outline, RADIUS)


def find_starts(ways):
    """Places of the finger from which it touches the outline, one for each place of that."""
    inward = np.column_stack([np.cos(ways.inward), np.sin(ways.inward)])
    return ways.touch - ways.standoff * inward


def walk(ways, begin, aim, turn, most):
    """Whether the finger gets from one place to another, in so many steps."""
    tip = np.array(begin)
    at = np.zeros(2)
    for _ in range(most):
        if np.linalg.norm(aim - tip) < ways.arrival:
            return True
        find_way(ways, tip[0], tip[1], aim[0], aim[1], turn, at)
        way = at - tip
        tip += way * min(1.0, STEP / max(float(np.linalg.norm(way)), 1e-9))
    return False


@pytest.mark.parametrize("name", OBJECTS)
@pytest.mark.parametrize("turn", [-1, 1])
def test_a_finger_gets_from_everywhere_to_everywhere_but_into_notches(name, turn):
    obj, ways = make_outline_paths(name)
    hull = obj.outline.convex_hull
    most = int(2 * hull.length / STEP)
    starts = find_starts(ways)
    near = obj.outline.buffer(DISC_CLEARANCE * RADIUS)
    for start in starts:
        nearest = ways.ring[np.linalg.norm(ways.ring - start, axis=1).argmin()]
        opposite = starts[np.linalg.norm(starts - start, axis=1).argmax()]
        # in sight of the ring, and so no deep notch
        if not near.intersects(LineString([start, nearest])):
            assert walk(ways, opposite, start, turn, most)
        assert walk(ways, start, starts[0], turn, most)


@pytest.mark.parametrize("name", OBJECTS)
def test_neighbors_on_the_ring_see_each_other(name):
    obj, ways = make_outline_paths(name)
    near = obj.outline.convex_hull.buffer(DISC_CLEARANCE * RADIUS)
    following = np.roll(ways.ring, -1, axis=0)
    for place, after in zip(ways.ring, following, strict=True):
        assert not near.intersects(LineString([place, after]))


@pytest.mark.parametrize("name", OBJECTS)
def test_a_plate_goes_round_as_the_disc_that_holds_it_and_comes_near(name):
    obj = GridObject.from_yaml(find_shipped_object(name))
    plate = PusherShape.plate(0.05, 0.02, 0.003)
    ways = make_outline_path(obj.outline, plate.radius, plate)
    disc = make_outline_path(obj.outline, plate.reach)
    assert (ways.ring == disc.ring).all()
    assert (ways.touch == disc.touch).all()
    gaps = [
        obj.outline.distance(plate.at([*near, angle]))
        for near, angle in zip(ways.near, ways.inward, strict=True)
    ]
    assert min(gaps) > NEAR_GAP
    assert np.median(gaps) < NEAR_GAP + 1e-3
