"""A grid object free in space: it lies still, and tips over an edge when its center of mass lies beyond it."""

import numpy as np
import pytest

from gridpush_drake.cli.shell.options import load_object
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.ground_truth import (
    SetGridObjectParameters,
    SetGridObjectPose,
    calc_rigid_loads,
    calc_support,
    sample_ground_truth,
)
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.plant_object import make_scene
from tests.helpers.shapes import rectangle

TABLE_EDGE = 2.0  # m, x of the edge of a table of 4 m about the origin


@pytest.mark.parametrize("name", ["claw_hammer", "toothpaste_tube"])
def test_lies_still(name):
    obj = load_object(name)
    params = sample_ground_truth(obj, 3, friction_by_part=True)
    scene = make_scene(obj, params, "free")
    SetGridObjectPose(scene.plant, scene.plant_context, scene.handle, (0.1, 0.2, 0.5))
    scene.simulator.AdvanceTo(1.0)
    assert np.abs(scene.pose() - (0.1, 0.2, 0.5)).max() < 1e-9
    np.testing.assert_allclose(scene.sphere_forces()[:, 2], params.mass * 9.81, rtol=1e-4)


@pytest.mark.parametrize("support", ["foundation", "three_feet"])
def test_loads_are_those_of_how_it_stands(support):
    obj = load_object("claw_hammer")
    params = CellParameters.by_part(obj, {1: 0.002, 2: 0.012}, 0.35)
    weight, center = params.total_mass * 9.81, params.center_of_mass(obj)
    feet = calc_support(Model(obj, params), support, 5, 0.012)
    scene = make_scene(obj, params, "free", support=feet)
    SetGridObjectPose(scene.plant, scene.plant_context, scene.handle, (0.1, 0.2, 0.5))
    scene.simulator.AdvanceTo(1.0)
    assert np.abs(scene.pose() - (0.1, 0.2, 0.5)).max() < 1e-5
    loads = scene.sphere_forces()[:, 2]
    assert loads.sum() == pytest.approx(weight, rel=1e-4)
    np.testing.assert_allclose(loads @ obj.p_BC / weight, center, atol=1e-4)
    if support == "three_feet":
        three = np.argsort(feet.stiffness)[-3:]
        balance = np.vstack([np.ones(3), obj.p_BC[three].T])
        expected = np.linalg.solve(balance, weight * np.array([1.0, *center]))
        np.testing.assert_allclose(loads[three], expected, rtol=0.01)
        return
    assert np.abs(loads / (params.mass * 9.81) - 1).max() > 0.5
    bears = loads > 0
    plane = np.column_stack([np.ones(obj.n), obj.p_BC])
    fitted = plane @ np.linalg.lstsq(plane[bears], loads[bears], rcond=None)[0]
    np.testing.assert_allclose(np.maximum(fitted, 0.0), loads, atol=0.01 * loads.max())


@pytest.mark.parametrize("support", ["three_feet", "vertices"])
def test_rigid_feet_bear_what_holds_the_body_lowest(support):
    """Its underside is 0.5 mm above the table, and bears nothing; nor do feet that end higher."""
    obj = load_object("claw_hammer")
    params = CellParameters.by_part(obj, {1: 0.002, 2: 0.012}, 0.35)
    feet = calc_support(Model(obj, params), support, 5, 0.012, rim_gap=5e-4)
    fractions = calc_rigid_loads(obj.p_BC, feet.gap, params.center_of_mass(obj))
    expected = params.total_mass * fractions
    scene = make_scene(obj, params, "free", support=feet, rim_gap=5e-4)
    SetGridObjectPose(scene.plant, scene.plant_context, scene.handle, (0.1, 0.2, 0.5))
    scene.simulator.AdvanceTo(1.0)
    loads = scene.sphere_forces()[:, 2] / 9.81
    assert (expected > 1e-9).sum() == 3
    np.testing.assert_allclose(loads, expected, atol=0.01 * expected.max())


@pytest.mark.parametrize("rim_gap", [0.0, 5e-4])
def test_other_supports_are_set_in_a_context(rim_gap):
    obj = load_object("claw_hammer")
    first, second = (sample_ground_truth(obj, seed) for seed in (3, 4))
    scene = make_scene(obj, first, "free", rim_gap=rim_gap)
    support = calc_support(Model(obj, second), "three_feet", 1, 0.012, rim_gap)
    SetGridObjectParameters(
        scene.plant, scene.scene_graph, scene.context, scene.handle, second, support
    )
    SetGridObjectPose(scene.plant, scene.plant_context, scene.handle, (0.0, 0.0, 0.0))
    scene.simulator.AdvanceTo(0.5)
    loads = scene.sphere_forces()[:, 2]
    feet = np.argsort(support.stiffness)[-3:]
    assert loads[feet].sum() == pytest.approx(second.total_mass * 9.81, rel=0.01)
    assert loads.sum() == pytest.approx(second.total_mass * 9.81, rel=1e-3)


@pytest.mark.parametrize("spheres_per_cell", [1, 4])
@pytest.mark.parametrize("heavy_end", [False, True])
def test_tips_over_the_edge_when_its_center_of_mass_is_beyond(spheres_per_cell, heavy_end):
    obj = GridObject.from_outline(rectangle(0.3, 0.03), max_cells=30, name="bar")
    mass = np.where(obj.p_BC[:, 0] > 0.1, 0.05, 0.01) if heavy_end else np.full(obj.n, 0.02)
    params = CellParameters(mass, np.full(obj.n, 0.4))
    scene = make_scene(obj, params, "free", spheres_per_cell=spheres_per_cell)
    center = params.center_of_mass(obj)[0]
    # spheres carry up to a cell less far than the edge reaches
    for beyond, tips in ((-1.5 * obj.cell_size, False), (1.5 * obj.cell_size, True)):
        SetGridObjectPose(
            scene.plant, scene.plant_context, scene.handle, (TABLE_EDGE + beyond - center, 0.0, 0.0)
        )
        scene.simulator.AdvanceTo(scene.context.get_time() + 0.5)
        assert (scene.tilt() > 0.1) == tips, beyond
        if not tips:
            assert scene.tilt() < 1e-3


def test_a_heavy_head_that_overhangs_does_not_tip_falsely():
    obj = load_object("claw_hammer")
    head = obj.p_BC[:, 0] > 0.08
    params = CellParameters(np.where(head, 0.012, 0.0012), np.full(obj.n, 0.35))
    scene = make_scene(obj, params, "free")
    # all that overhangs is the light end of the handle
    handle_end = obj.p_BC[:, 0].min()
    x = -TABLE_EDGE - handle_end - 0.15
    SetGridObjectPose(scene.plant, scene.plant_context, scene.handle, (x, 0.0, 0.0))
    scene.simulator.AdvanceTo(1.0)
    assert scene.tilt() < 1e-3
    assert abs(scene.pose()[0] - x) < 1e-5


def test_falls_off_the_table():
    obj = GridObject.from_outline(rectangle(0.1, 0.05), max_cells=8, name="block")
    params = CellParameters.uniform(obj, 0.2, 0.3)
    scene = make_scene(obj, params, "free")
    SetGridObjectPose(scene.plant, scene.plant_context, scene.handle, (TABLE_EDGE + 0.1, 0.0, 0.0))
    scene.simulator.AdvanceTo(0.2)
    height = scene.plant.EvalBodyPoseInWorld(scene.plant_context, scene.handle.body).translation()[
        2
    ]
    assert height == pytest.approx(-9.81 * 0.2**2 / 2, rel=0.02)
