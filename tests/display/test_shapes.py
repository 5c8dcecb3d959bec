import struct

import numpy as np
import pytest

from gridpush_drake.cli.view.view_scene import AddPusher
from gridpush_drake.display.server import StartMeshcatServer
from gridpush_drake.display.shapes import (
    AddArrow,
    AddCenter,
    make_arrow,
    make_cell_prisms,
    make_disc,
    make_outline_edge,
    make_outline_prism,
    make_ring,
)
from gridpush_drake.dynamics.push import Push
from tests.helpers.scene_cases import PLATE
from tests.helpers.shapes import SHAPES, make_shape

HEIGHT = 0.03


def areas(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def area_at(mesh, height):
    flat = (mesh.vertices[mesh.faces][:, :, 2] == height).all(axis=1)
    return areas(mesh)[flat].sum()


def test_cells_have_their_area_at_the_top_and_four_walls_each():
    obj = make_shape("l_bracket", 40)
    mesh = make_cell_prisms(obj, HEIGHT, fraction=0.9)
    side = 0.9 * obj.cell_size
    assert area_at(mesh, HEIGHT) == pytest.approx(obj.n * side**2)
    assert areas(mesh).sum() == pytest.approx(obj.n * (side**2 + 4 * side * HEIGHT))
    np.testing.assert_allclose(
        mesh.vertices.reshape(8, obj.n, 3).mean(axis=0)[:, :2], obj.p_BC, atol=1e-15
    )


@pytest.mark.parametrize("name", SHAPES)
def test_an_outline_s_prism_has_its_area_and_its_walls(name):
    obj = make_shape(name)
    mesh = make_outline_prism(obj, HEIGHT)
    assert area_at(mesh, HEIGHT) == pytest.approx(obj.outline.area)
    assert areas(mesh).sum() == pytest.approx(obj.outline.area + obj.outline.length * HEIGHT)


def test_an_edge_is_as_long_as_the_outline():
    obj = make_shape("wrench")
    assert areas(make_outline_edge(obj, HEIGHT, 1e-4)).sum() == pytest.approx(
        1e-4 * obj.outline.length, rel=0.01
    )


def test_an_ellipse_has_the_covariance_s_axes():
    covariance, center = np.array([[4e-4, 1e-4], [1e-4, 2e-4]]), np.array([0.1, -0.2])
    disc = make_disc(covariance, center, HEIGHT)
    away = disc.vertices[:-1, :2] - center
    np.testing.assert_allclose(np.einsum("ki,ij,kj->k", away, np.linalg.inv(covariance), away), 1.0)
    assert areas(disc).sum() == pytest.approx(np.pi * np.sqrt(np.linalg.det(covariance)), rel=0.01)
    ring = make_ring(covariance, center, HEIGHT, 1e-3)
    assert np.linalg.norm(ring.vertices[:, :2] - center, axis=1).max() == pytest.approx(
        np.sqrt(np.linalg.eigvalsh(covariance)[-1]) + 1e-3, rel=0.01
    )


def test_an_ellipse_without_width_is_a_line():
    covariance = np.diag([4e-4, 0.0])
    disc, ring = (
        make_disc(covariance, (0.1, 0.2), HEIGHT),
        make_ring(covariance, (0.1, 0.2), HEIGHT, 1e-3),
    )
    assert np.ptp(disc.vertices[:, 0]) == pytest.approx(0.04)
    assert np.ptp(disc.vertices[:, 1]) < 1e-4
    assert areas(disc).sum() < areas(ring).sum()


@pytest.mark.parametrize("length", [0.1, 0.004])
def test_an_arrow_reaches_from_its_start_to_its_end(length):
    start, along = np.array([0.3, 0.1]), np.array([0.6, 0.8])
    arrow = make_arrow(start, start + length * along, HEIGHT, 0.005)
    reach = (arrow.vertices[:, :2] - start) @ along
    assert (reach.min(), reach.max()) == pytest.approx((0.0, length), abs=1e-15)


@pytest.mark.parametrize("center", [(np.nan, 0.0), (0.0, np.inf)])
def test_draws_nothing_of_a_center_that_is_not_finite(center):
    meshcat = StartMeshcatServer(0)
    AddCenter(meshcat, "center", center, 1e-4 * np.eye(2), HEIGHT)
    assert not meshcat.HasPath("center")
    AddCenter(meshcat, "center", (0.0, 0.0), np.full((2, 2), np.nan), HEIGHT)
    assert meshcat.HasPath("center/dot") and not meshcat.HasPath("center/edge")


@pytest.mark.parametrize("end", [(0.1, 0.2), (0.1, 0.2 + 1e-9), (np.nan, 0.2)])
def test_draws_nothing_of_an_arrow_without_length(end):
    meshcat = StartMeshcatServer(0)
    AddArrow(meshcat, "arrow", (0.1, 0.2), end, HEIGHT)
    assert not meshcat.HasPath("arrow")
    AddArrow(meshcat, "arrow", (0.1, 0.2), (0.1, 0.2001), HEIGHT)
    assert meshcat.HasPath("arrow")


def test_a_pusher_of_another_shape_is_turned_in_a_replay():
    meshcat = StartMeshcatServer()
    push = Push.about((0.0, 0.2), 0.5, shape=PLATE, start=(-0.1, 0.0), yaw=0.3, duration=1.0)
    meshcat.StartRecording()
    AddPusher(meshcat, push, 0, 0.0, HEIGHT)
    # a matrix of MessagePack's 64-bit numbers, each after a byte that says so, column by column
    packed = meshcat._GetPackedTransform("pushes/0/finger").partition(b"matrix")[2][3:]
    cosine, sine = (struct.unpack(">d", packed[9 * k + 1 : 9 * k + 9])[0] for k in (0, 1))
    assert (cosine, sine) == pytest.approx((np.cos(0.8), np.sin(0.8)))
