from time import perf_counter

import numpy as np
import pytest
import shapely

from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.pregrasp.uncertainty import PlausibleMassSet
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.report.pregrasp_figure import GraspDrawn, PushDrawn, draw_pre_grasp
from gridpush_drake.report.slide_figure import CLOSE_UP

MANY_POSES = 60
MAX_SECONDS = 2.0


def draw(obj, poses, grasp=None):
    surface = SupportSurface(shapely.box(-0.5, -0.5, 0.5, 0.0))
    push = PushDrawn(np.array([-0.12, -0.3]), np.array([-0.12, -0.2]), poke=True)
    return draw_pre_grasp(
        obj, surface, poses, [push], PlausibleMassSet.of_masses(obj, CellParameters.uniform(obj)), None, grasp
    )


def test_frames_everything_drawn_with_the_same_room_all_round():
    """The frame is the bounding box of discs about all points, which shapely finds slowly."""
    obj = GridObject.from_outline([[0, 0], [0.12, 0], [0.12, 0.06], [0, 0.06]], max_cells=8)
    poses = [np.array([0.0, -0.3, 0.4]), np.array([0.1, -0.2, 0.9]), np.array([0.1, -0.01, 1.5])]
    way, end = draw(obj, poses, GraspDrawn(np.array([0.1, 0.05]), -1.5)).axes
    points = np.concatenate([*(obj.cells_at(pose) for pose in poses), [[-0.12, -0.3], [-0.12, -0.2]]])
    slow = shapely.MultiPoint(points).buffer(CLOSE_UP).bounds
    assert (*way.get_xlim(), *way.get_ylim()) == pytest.approx([slow[0], slow[2], slow[1], slow[3]])
    low, high = end.get_xlim(), end.get_ylim()
    cells = shapely.MultiPoint(obj.cells_at(poses[-1])).buffer(CLOSE_UP).bounds
    assert low[0] <= cells[0]
    assert high[1] >= cells[3]


def test_draws_many_poses_quickly():
    obj = GridObject.from_yaml(find_shipped_object("claw_hammer"))
    rng = np.random.default_rng(0)
    poses = list(np.column_stack([rng.uniform(-0.3, 0.3, (MANY_POSES, 2)) - (0, 0.3), rng.uniform(-3, 3, MANY_POSES)]))
    begin = perf_counter()
    draw(obj, poses)
    assert perf_counter() - begin < MAX_SECONDS
