"""The figure of a pre-grasp run: what was done to the object, and why it stays put where it was grasped."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sin

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon
from numpy.typing import NDArray

from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.pregrasp.stability import SUPPORT_INSET, calc_support_polygon
from gridpush_drake.planning.pregrasp.uncertainty import PlausibleMassSet
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.report.draw import FONT, INK, draw_cells, draw_outline
from gridpush_drake.report.maps import BEFORE, FAINT, LEARNED, PAGE_WIDTH, make_grid
from gridpush_drake.report.slide_figure import CLOSE_UP, GRASP, HOLDS, TABLE

Array = NDArray[np.float64]

PANEL_HEIGHT = 4.4
"""Inches."""

JAW_LENGTH, JAW_WIDTH = 0.08, 0.02
"""Of the gripper's fingers as drawn, m."""

LEGEND_BELOW = -0.15
"""Of the axes' height."""


@dataclass(frozen=True, eq=False)
class PushDrawn:
    """A push as it was made.

    Attributes:
        start: (2,) of the finger's center, W, m.
        end: (2,) likewise.
        poke: whether it was to learn; else to slide.
    """

    start: Array
    end: Array
    poke: bool


@dataclass(frozen=True, eq=False)
class GraspDrawn:
    """A grasp as it was made.

    Attributes:
        point: (2,) p_WG, m.
        approach: heading of the fingers, rad.
    """

    point: Array
    approach: float


def draw_pre_grasp(
    obj: GridObject,
    surface: SupportSurface,
    poses: Sequence[Array],
    pushes: Sequence[PushDrawn],
    masses: PlausibleMassSet,
    truth: CellParameters | None = None,
    grasp: GraspDrawn | None = None,
) -> Figure:
    """Draws a run: on the left the way, on the right the object as it lay at the end.

    Args:
        obj: the object.
        surface: the table.
        poses: (3,) of the object at rest, in order, the last one where it was grasped, or given up.
        pushes: in order.
        masses: the masses held possible at the end.
        truth: what the object really weighs, where that is known.
        grasp: as it was made; None where there was none.

    Returns:
        The figure.
    """
    figure, axes = make_grid(1, 2, PAGE_WIDTH, PANEL_HEIGHT)
    _draw_way(axes[0, 0], obj, surface, poses, pushes)
    _draw_end(axes[0, 1], obj, surface, poses[-1], masses, truth, grasp)
    return figure


def _draw_way(
    ax: Axes, obj: GridObject, surface: SupportSurface, poses: Sequence[Array], pushes: Sequence[PushDrawn]
) -> None:
    _draw_table(ax, surface)
    for pose in poses[1:-1]:
        draw_outline(ax, obj, pose=pose, color=FAINT)
    draw_outline(ax, obj, pose=poses[0], color=INK, linestyle="dashed")
    draw_cells(ax, obj, pose=poses[-1])
    for push in pushes:
        color = BEFORE if push.poke else LEARNED
        ax.annotate(
            "", tuple(push.end), tuple(push.start),
            arrowprops={"arrowstyle": "-|>", "color": color, "linewidth": 1.5, "shrinkA": 0, "shrinkB": 0}, zorder=5,
        )  # fmt: skip
    points = np.concatenate([obj.cells_at(pose) for pose in poses] + [np.array([p.start, p.end]) for p in pushes])
    _frame(ax, points)
    _add_legend(
        ax,
        [
            Line2D([], [], color=INK, linestyle="dashed", label="at first"),
            Line2D([], [], color=BEFORE, marker=">", label="pokes"),
            Line2D([], [], color=LEARNED, marker=">", label="slides"),
        ],
    )
    ax.set_title("The way to the table's edge", fontsize=FONT, color=INK)


def _draw_end(
    ax: Axes,
    obj: GridObject,
    surface: SupportSurface,
    pose: Array,
    masses: PlausibleMassSet,
    truth: CellParameters | None,
    grasp: GraspDrawn | None,
) -> None:
    _draw_table(ax, surface)
    draw_cells(ax, obj, pose=pose, alpha=0.6)
    handles = []
    hull = calc_support_polygon(obj, pose, surface, SUPPORT_INSET)
    for p_BP, color, label in (
        (hull, HOLDS, "what holds it"),
        (masses.center_of_mass_polygon, BEFORE, "where its center of mass may be"),
    ):
        if len(p_BP):
            ax.add_patch(Polygon(_place(p_BP, pose), facecolor=f"{color}33", edgecolor=color, linewidth=1.4))
            handles.append(Line2D([], [], color=color, label=label))
    if truth is not None:
        (at,) = _place(truth.center_of_mass(obj)[None], pose)
        ax.plot(*at, marker="x", color=INK, markersize=7, markeredgewidth=1.8, linestyle="none", zorder=6)
        handles.append(Line2D([], [], color=INK, marker="x", linestyle="none", label="where it truly is"))
    points = obj.cells_at(pose)
    if grasp is not None:
        jaw = _make_jaw(grasp)
        ax.add_patch(Polygon(jaw, facecolor=f"{GRASP}55", edgecolor=GRASP, linewidth=1.2, zorder=4))
        ax.add_patch(Circle((grasp.point[0], grasp.point[1]), JAW_WIDTH / 4, color=GRASP, zorder=5))
        handles.append(Line2D([], [], color=GRASP, label="gripper"))
        points = np.concatenate([points, jaw])
    _frame(ax, points)
    _add_legend(ax, handles)
    ax.set_title("Where it was grasped" if grasp is not None else "Where it lay at last", fontsize=FONT, color=INK)


def _make_jaw(grasp: GraspDrawn) -> Array:
    """(4, 2) corners of the fingers seen from above, their tips a little beyond the grasp point."""
    along = np.array([cos(grasp.approach), sin(grasp.approach)])
    across = np.array([-along[1], along[0]]) * JAW_WIDTH / 2
    tip, root = grasp.point + JAW_WIDTH * 0.75 * along, grasp.point - (JAW_LENGTH - JAW_WIDTH) * along
    return np.array([tip + across, tip - across, root - across, root + across])


def _add_legend(ax: Axes, handles: Sequence[Line2D]) -> None:
    ax.legend(
        handles=handles, fontsize=FONT - 1, frameon=False, loc="upper center", bbox_to_anchor=(0.5, LEGEND_BELOW),
        ncols=2,
    )  # fmt: skip


def _draw_table(ax: Axes, surface: SupportSurface) -> None:
    ax.add_patch(Polygon(surface.corners, facecolor=TABLE, edgecolor=FAINT, linewidth=1.0, zorder=0))


def _frame(ax: Axes, points: Array) -> None:
    (left, low), (right, high) = points.min(axis=0) - CLOSE_UP, points.max(axis=0) + CLOSE_UP
    ax.set_xlim(left, right)
    ax.set_ylim(low, high)
    ax.set_aspect("equal", adjustable="box")


def _place(p_BP: Array, pose: Array) -> Array:
    x, y, theta = pose
    c, s = np.cos(theta), np.sin(theta)
    return p_BP @ np.array([[c, s], [-s, c]]) + (x, y)
