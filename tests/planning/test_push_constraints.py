"""The rules of pushes: what is asked by circles first is what the body itself is told."""

import numpy as np
import pytest
import shapely
from shapely import Polygon, box

from gridpush_drake.geometry.se2 import transform
from gridpush_drake.planning.push_constraints import PushConstraints, make_body
from gridpush_drake.planning.support_surface import SupportSurface
from tests.helpers.shapes import make_shape

OBSTACLES = (box(0.05, 0.1, 0.12, 0.15), Polygon([(-0.2, -0.2), (-0.1, -0.2), (-0.15, -0.1)]))
TABLES = {
    "round": SupportSurface.round((0.0, 0.0), 0.4),
    "concave": SupportSurface(
        Polygon([(-0.4, -0.4), (0.4, -0.4), (0.4, 0.0), (0.0, 0.0), (0.0, 0.4), (-0.4, 0.4)])
    ),
}


@pytest.mark.parametrize("table", [None, *TABLES])
@pytest.mark.parametrize("obstacles", [(), OBSTACLES], ids=["free", "obstacles"])
def test_poses_are_allowed_where_the_whole_body_is(table: str | None, obstacles: tuple) -> None:
    obj = make_shape("bar", 40)
    surface = None if table is None else TABLES[table]
    rules = PushConstraints(surface, obstacles, edge_margin=0.01, obstacle_margin=0.02)
    checker = rules.start_at(obj, np.array([-0.2, 0.2, 0.0]), 0.008)
    rng = np.random.default_rng(0)
    poses = np.column_stack([rng.uniform(-0.5, 0.5, (4000, 2)), rng.uniform(-3, 3, 4000)])
    corners = np.array(make_body(obj).exterior.coords)[:-1]
    bodies = shapely.polygons(transform(poses, corners))
    expected = np.ones(len(poses), dtype=bool)
    if surface is not None:
        expected &= shapely.covers(surface.polygon.buffer(-0.01 + 1e-6), bodies)
    for obstacle in obstacles:
        expected &= shapely.distance(obstacle, bodies) >= 0.02 - 1e-6
    found = checker.allows_geometry(poses)
    # about corners of the obstacles, margins are polygons: off by 25 µm
    assert (found != expected).sum() <= 2
    if surface is not None or obstacles:
        assert 100 < expected.sum() < 3900


def test_steps_are_counted_for_every_model_as_for_each() -> None:
    obj = make_shape("bar", 40)
    rules = PushConstraints(TABLES["round"], OBSTACLES)
    checker = rules.start_at(obj, np.zeros(3), 0.008)
    rng = np.random.default_rng(1)
    tip = np.column_stack([np.linspace(0.0, 0.3, 301), np.full(301, 0.02)])
    goals = np.column_stack([rng.uniform(-0.4, 0.4, (20, 2)), rng.uniform(-2, 2, 20)])
    poses = np.linspace(np.zeros((20, 3)), goals, 301, axis=1)
    counts = checker.count_allowed_by_models(tip, poses)
    assert counts.tolist() == [checker.count_allowed(tip, some) for some in poses]
    assert len(set(counts.tolist())) > 5
