"""Where the disc touches, against shapely's distances."""

import numpy as np
import pytest
import shapely
from shapely import LineString, Point, Polygon, box

from gridpush_drake.dynamics.kernels.contact.contact import (
    BEND,
    CONTACT_COLUMNS,
    CX,
    CY,
    GAP,
    GX,
    GY,
    NX,
    NY,
    Edges,
    find_contacts,
    find_contacts_near,
    look_ahead,
    look_ahead_near,
    make_near_edges,
)
from gridpush_drake.geometry.polygons import OutlineEdges
from tests.helpers.finite_difference import check_jacobian
from tests.helpers.random_objects import make_random_object
from tests.helpers.shapes import SHAPES, rectangle, regular_polygon


def kernel_edges(outline):
    edges = OutlineEdges.from_polygon(outline)
    return Edges(*edges.start.T.copy(), *edges.end.T.copy(), np.array(edges.previous))


def find(outline, center, radius=0.005, reach=0.01):
    contacts = np.zeros((2, CONTACT_COLUMNS))
    count = find_contacts(
        kernel_edges(outline), float(center[0]), float(center[1]), radius, reach, contacts
    )
    return contacts[:count]


def make_random_outline(seed):
    """A star-shaped polygon with a hole, or a blob of cells."""
    rng = np.random.default_rng(seed)
    if seed % 2:
        return make_random_object(rng, 15, 0.02).outline
    angle = np.sort(rng.uniform(0, 2 * np.pi, 14))
    outer = rng.uniform(0.05, 0.1, 14)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    star = Polygon(outer)
    hole = star.buffer(-0.02)
    return star.difference(hole if hole.geom_type == "Polygon" else Point(0, 0).buffer(0.01))


@pytest.mark.parametrize("seed", range(12))
def test_nearest_contact_is_shapely_s(seed):
    outline, rng, checked = make_random_outline(seed), np.random.default_rng(seed + 100), 0
    boundary = outline.boundary
    low, high = np.array(outline.bounds).reshape(2, 2) + [[-0.02], [0.02]]
    for center in rng.uniform(low, high, (300, 2)):
        point, radius, reach = Point(center), rng.uniform(0.001, 0.02), 0.01
        distance = boundary.distance(point)
        inside = outline.contains(point)
        contacts = find(outline, center, radius, reach)
        if inside:
            assert len(contacts) == 1
            assert contacts[0, GAP] == pytest.approx(
                -distance - radius, abs=1e-12
            ) or nearest_is_reflex(outline, point)
        elif distance - radius > reach:
            assert not len(contacts)
            continue
        else:
            assert contacts[0, GAP] == pytest.approx(distance - radius, abs=1e-12)
            foot = (
                boundary.interpolate(boundary.project(point))
                if boundary.geom_type == "LineString"
                else None
            )
            if foot is not None:
                np.testing.assert_allclose(contacts[0, [CX, CY]], [foot.x, foot.y], atol=1e-9)
        for row in contacts:
            p, normal = row[[CX, CY]], row[[NX, NY]]
            assert np.linalg.norm(normal) == pytest.approx(1.0)
            np.testing.assert_array_equal(row[[GX, GY]], normal)
            assert boundary.distance(Point(p)) < 1e-12
            signed = (p - center) @ normal
            np.testing.assert_allclose(p, center + signed * normal, atol=1e-12)
            assert row[GAP] == pytest.approx(signed - radius, abs=1e-12)
            assert row[BEND] == pytest.approx(
                1 / signed if is_vertex(outline, p) else 0.0, rel=1e-6
            )
        checked += 1
    assert checked > 30


def is_vertex(outline, p):
    return np.linalg.norm(shapely.get_coordinates(outline) - p, axis=1).min() < 1e-12


def nearest_is_reflex(outline, point):
    return is_vertex(
        outline, shapely.get_coordinates(shapely.shortest_line(outline.boundary, point))[0]
    )


def test_an_inward_normal_points_into_the_object():
    for name, make in SHAPES.items():
        outline = make()
        for s in np.linspace(0, outline.exterior.length, 37)[:-1]:
            point, _, outward = OutlineEdges.from_polygon(outline).at(s)
            row = find(outline, point + 0.001 * outward, radius=0.0005, reach=0.001)[0]
            inner = row[[CX, CY]] + 1e-7 * row[[NX, NY]]
            assert outline.buffer(1e-9).contains(Point(inner)), (name, s)


def test_two_contacts_in_a_concave_corner_nearest_first():
    corner = box(-0.1, -0.1, 0.1, 0.1).difference(box(0.0, 0.0, 0.2, 0.2))
    contacts = find(corner, (0.006, 0.0055))
    np.testing.assert_allclose(contacts[:, [NX, NY]], [[0, -1], [-1, 0]], atol=1e-15)
    np.testing.assert_allclose(contacts[:, GAP], [0.0005, 0.001], atol=1e-15)
    np.testing.assert_allclose(contacts[:, [CX, CY]], [[0.006, 0], [0, 0.0055]], atol=1e-15)


def test_of_three_contacts_the_nearest_two():
    slot = box(-0.1, -0.1, 0.1, 0.1).difference(box(-0.006, 0.0, 0.006, 0.2))
    contacts = find(slot, (0.0001, 0.0055))
    np.testing.assert_allclose(contacts[:, GAP], [0.0005, 0.0009], atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.0, 2.5])
def test_split_edges_give_one_contact(angle):
    """Vertices in the middle of a straight side, with the disc right over them."""
    square = Polygon(rectangle(0.1, 0.1))
    turned = shapely.affinity.rotate(
        square.segmentize(0.01), angle, origin=(0, 0), use_radians=True
    )
    c, s = np.cos(angle), np.sin(angle)
    for along in np.linspace(-0.04, 0.04, 17):
        x, y = along, 0.0551
        contacts = find(turned, (c * x - s * y, s * x + c * y))
        assert len(contacts) == 1
        assert contacts[0, GAP] == pytest.approx(0.0001, abs=1e-12)
        np.testing.assert_allclose(contacts[0, [NX, NY]], [s, -c], atol=1e-9)
    inside = find(turned, (-s * 0.0499, c * 0.0499))
    assert len(inside) == 1
    assert inside[0, GAP] == pytest.approx(-0.0051, abs=1e-12)


def test_a_disc_round_a_many_gon_slides_from_edge_to_vertex_without_a_jump():
    outline = Polygon(regular_polygon(0.05, 40))
    rows = np.array(
        [
            find(outline, 0.0545 * np.array([np.cos(a), np.sin(a)]))[0]
            for a in np.linspace(0, 1, 2001)
        ]
    )
    assert {
        len(find(outline, 0.0545 * np.array([np.cos(a), np.sin(a)])))
        for a in np.linspace(0, 1, 201)
    } == {1}
    assert np.abs(np.diff(rows[:, [NX, NY, CX, CY, GAP]], axis=0)).max() < 0.01
    assert 0.05 < (rows[:, BEND] > 0).mean() < 0.9


def test_a_disc_inside_a_hole_touches_it_from_within():
    ring = Polygon(regular_polygon(0.03, 60), [regular_polygon(0.02, 60)])
    contacts = find(ring, (0.0, 0.014))
    np.testing.assert_allclose(contacts[0, [NX, NY]], [0, 1], atol=0.06)
    assert contacts[0, GAP] == pytest.approx(0.001, abs=1e-4)
    assert not len(find(ring, (0.0, 0.0), reach=0.001))


def test_looking_ahead_takes_the_place_from_there_and_the_gap_from_here():
    """Towards the end of a side and round its corner: the gap to an edge is that to its line, to a corner the least."""
    square = Polygon(rectangle(0.1, 0.1))
    edges, found, ahead = (
        kernel_edges(square),
        np.zeros((2, CONTACT_COLUMNS)),
        np.zeros((2, CONTACT_COLUMNS)),
    )

    def look(x, dx):
        find_contacts(edges, x, 0.056, 0.005, 0.01, found)
        assert look_ahead(edges, x, 0.056, dx, -0.004, 0.005, 0.01, found, ahead) == 1
        return ahead[0]

    row = look(0.03, 0.004)
    np.testing.assert_allclose(
        row[[NX, NY, CX, CY, GAP, BEND]], [0, -1, 0.034, 0.05, 0.001, 0], atol=1e-15
    )
    row = look(0.048, 0.004)  # the vertex region, though it is over the side now
    direction = np.array([-0.002, -0.006]) / np.hypot(0.002, 0.006)
    np.testing.assert_allclose(row[[NX, NY]], direction)
    np.testing.assert_allclose(row[[GAP, GX, GY]], [0.001, 0, -1], atol=1e-15)
    assert row[BEND] == pytest.approx(1 / np.hypot(0.002, 0.006))


def test_derivatives_of_a_contact():
    """dN = -bend alpha T, dc = alpha T on an edge, dgap = -N·dt, with alpha = T·dt."""
    outline = SHAPES["l_bracket"]()
    rng, kinds = np.random.default_rng(0), set()
    for s in rng.uniform(0, outline.exterior.length, 60):
        point, _, outward = OutlineEdges.from_polygon(outline).at(s)
        center = point + 0.006 * outward + rng.normal(size=2) * 0.003
        contacts = find(outline, center)
        if not len(contacts):
            continue
        row = contacts[0]
        N, T, bend = row[[NX, NY]], np.array([-row[NY], row[NX]]), row[BEND]
        kinds.add(bool(bend))
        expected = np.vstack([-bend * np.outer(T, T), (bend == 0) * np.outer(T, T), -N])
        check_jacobian(
            lambda x: find(outline, x)[0][[NX, NY, CX, CY, GAP]],
            center,
            expected,
            step=1e-6,
            rtol=1e-6,
            atol=1e-7,
        )
    assert kinds == {True, False}


def test_line_distance_matches_for_every_edge_alone():
    outline = make_random_outline(3)
    for start, end in zip(
        *(lambda e: (e.start, e.end))(OutlineEdges.from_polygon(outline)), strict=True
    ):
        middle, direction = (start + end) / 2, (end - start) / np.linalg.norm(end - start)
        center = middle + 1e-4 * np.array([direction[1], -direction[0]])
        assert find(outline, center, 0.001)[0, GAP] == pytest.approx(
            LineString([start, end]).distance(Point(center)) - 0.001, abs=1e-12
        )


@pytest.mark.parametrize("seed", range(8))
def test_the_edges_near_the_disc_say_what_all_edges_say(seed):
    """Number for number, on a path that goes along, through and away from an outline."""
    outline, rng = make_random_outline(seed), np.random.default_rng(seed)
    edges = kernel_edges(outline)
    near = make_near_edges(edges)
    found = [np.zeros((2, CONTACT_COLUMNS)) for _ in range(4)]
    place = np.array(outline.exterior.coords[0])
    radius, counts, chosen = 0.006, [], []
    for _ in range(3000):
        # mostly small steps, some jumps, drawn back to the outline
        place = place + rng.normal(0.0, 0.02 if rng.random() < 0.02 else 0.001, 2)
        if outline.boundary.distance(Point(place)) > 0.015:
            place = np.array(outline.boundary.interpolate(rng.random(), normalized=True).coords[0])
        reach = rng.uniform(0.0, 0.004)
        for contacts in found:
            contacts[:] = 0.0
        count = find_contacts(edges, *place, radius, reach, found[0])
        assert find_contacts_near(edges, near, *place, radius, reach, found[1]) == count
        assert np.array_equal(found[0], found[1])
        counts.append(count)
        chosen.append(near.size[0])
        if count == 0:
            continue
        ahead = rng.normal(0.0, 0.002, 2)
        there = look_ahead(edges, *place, *ahead, radius, reach, found[0], found[2])
        again = look_ahead_near(edges, near, *place, *ahead, radius, reach, found[1], found[3])
        assert again == there
        assert np.array_equal(found[2], found[3])
    # all cases came up: nothing, one and two contacts; few edges, and all where it was inside
    assert {0, 1, 2} <= set(counts)
    assert -1 in chosen and 0 < np.median([n for n in chosen if n > 0]) < len(edges.ax) / 2


def test_a_place_on_the_outline_cannot_be_changed_by_who_asked_for_it() -> None:
    edges = OutlineEdges.from_polygon(Polygon([(0, 0), (0.2, 0), (0.2, 0.1), (0, 0.1)]))
    for arc_length, outward in ((0.05, (0, -1)), (0.25, (1, 0)), (0.35, (0, 1)), (0.65, (0, -1))):
        _, tangent, normal = edges.at(arc_length)
        np.testing.assert_allclose(normal, outward, atol=1e-15)
        np.testing.assert_allclose([-tangent[1], tangent[0]], -normal, atol=1e-15)
        with pytest.raises(ValueError, match="read-only"):
            normal[:] = 0.0
