"""Outlines of known shapes, and tools drawn after real ones: convex, concave, slender, with holes."""

import numpy as np
from numpy.typing import NDArray
from shapely import Polygon

from gridpush_drake.objects.grid_object import GridObject


def regular_polygon(radius: float, corners: int = 120, phase: float = 0.0) -> NDArray[np.float64]:
    """(corners, 2) vertices on a circle, m."""
    angle = phase + 2 * np.pi * np.arange(corners) / corners
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def rectangle(length: float, width: float) -> NDArray[np.float64]:
    """(4, 2) corners about the origin, m."""
    return np.array([[-length, -width], [length, -width], [length, width], [-length, width]]) / 2


def notched_block(side: float = 0.1, depth: float = 0.03, half_width: float = 0.03) -> Polygon:
    """A square with a V-notch in its left side, symmetric about the x axis."""
    h = side / 2
    return Polygon(
        [(-h, -h), (h, -h), (h, h), (-h, h), (-h, half_width), (-h + depth, 0.0), (-h, -half_width)]
    )


def claw_hammer() -> Polygon:
    """0.28 m long, the head at +x with its face down and its claw, a V, up."""
    handle = [
        (-0.20, -0.012),
        (0.03, -0.010),
        (0.03, -0.055),
        (0.062, -0.055),
        (0.062, -0.01),
        (0.064, 0.02),
    ]
    claw = [
        (0.080, 0.060),
        (0.070, 0.066),
        (0.046, 0.018),
        (0.022, 0.066),
        (0.012, 0.060),
        (0.028, 0.010),
    ]
    return Polygon([*handle, *claw, (-0.20, 0.012)])


def wrench() -> Polygon:
    """0.22 m long, a ring at -x and an open jaw at +x."""
    ring = Polygon(regular_polygon(0.022, 24) - [0.1, 0.0])
    shaft = Polygon(rectangle(0.18, 0.014))
    head = Polygon(regular_polygon(0.026, 24) + [0.1, 0.0])
    jaw = Polygon([(0.096, -0.010), (0.14, -0.012), (0.14, 0.012), (0.096, 0.010)])
    hole = Polygon(regular_polygon(0.012, 24) - [0.1, 0.0])
    return ring.union(shaft).union(head).difference(jaw).difference(hole)


def l_bracket() -> Polygon:
    """Two arms of 0.12 and 0.08 m."""
    return Polygon(
        [(-0.03, -0.02), (0.09, -0.02), (0.09, 0.01), (0.0, 0.01), (0.0, 0.06), (-0.03, 0.06)]
    )


def triangle() -> Polygon:
    """The right-angled triangle of the CMU pushes, about its centroid."""
    return Polygon([(-0.05, -0.05), (0.10, -0.05), (-0.05, 0.10)])


SHAPES = {
    "square": lambda: Polygon(rectangle(0.1, 0.1)),
    "disc": lambda: Polygon(regular_polygon(0.05, 90)),
    "triangle": triangle,
    "l_bracket": l_bracket,
    "claw_hammer": claw_hammer,
    "wrench": wrench,
    "notched_block": notched_block,
    "bar": lambda: Polygon(rectangle(0.25, 0.02)),
}


def make_shape(name: str, max_cells: int = 100) -> GridObject:
    """One of `SHAPES`, filled with cells."""
    return GridObject.from_outline(SHAPES[name](), max_cells=max_cells, name=name)
