"""The figure of a pre-grasp slide: the way to the table's edge, and why the object stays put there."""

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.dynamics.push import Push
from gridpush_drake.planning.pregrasp.planner import PreGraspPlan, PreGraspPlanner
from gridpush_drake.planning.pregrasp.stability import calc_support_polygon
from gridpush_drake.planning.pregrasp.uncertainty import PlausibleMassSet
from gridpush_drake.report.draw import FONT, INK, draw_cells, draw_outline
from gridpush_drake.report.maps import BEFORE, FAINT, LEARNED, PAGE_WIDTH, make_grid

TABLE = "#f3efe6"
"""The table's top."""

HOLDS = "#4f9d69"
"""What holds the object."""

GRASP = "#b3423f"
"""What the gripper takes."""

PANEL_HEIGHT = 4.0
"""Inches."""

CLOSE_UP = 0.06
"""Room about the object in the close-up, m."""

MM = 1e3
"""Millimeters in a meter."""


def draw_slide(planner: PreGraspPlanner, masses: PlausibleMassSet, plan: PreGraspPlan) -> Figure:
    """Draws a plan: on the left the way, on the right the goal with what holds the object and what hangs over.

    Args:
        planner: object, table and options.
        masses: the masses that stability was judged on.
        plan: the plan; where nothing is safe, its safest goal is drawn.

    Returns:
        The figure.
    """
    figure, axes = make_grid(1, 2, PAGE_WIDTH, PANEL_HEIGHT)
    _draw_way(axes[0, 0], planner, plan)
    _draw_goal(axes[0, 1], planner, masses, plan)
    return figure


def _draw_way(ax: Axes, planner: PreGraspPlanner, plan: PreGraspPlan) -> None:
    _draw_table(ax, planner)
    for pose in plan.poses[:-1]:
        draw_outline(ax, planner.obj, pose=pose, color=FAINT)
    draw_outline(ax, planner.obj, pose=plan.poses[0], color=INK, linestyle="dashed")
    draw_cells(ax, planner.obj, pose=plan.poses[-1])
    for push in plan.pushes:
        _draw_push(ax, push, LEARNED)
    if plan.poke is not None:
        _draw_push(ax, plan.poke, BEFORE)
    x0, y0, x1, y1 = planner.surface.polygon.bounds
    _frame(ax, (x0 - CLOSE_UP, y0 - CLOSE_UP, x1 + CLOSE_UP, y1 + CLOSE_UP))
    count = len(plan.pushes)
    ax.set_title(f"{plan.status}: {count} push{'' if count == 1 else 'es'}", fontsize=FONT, color=INK)


def _draw_goal(ax: Axes, planner: PreGraspPlanner, masses: PlausibleMassSet, plan: PreGraspPlan) -> None:
    goal = plan.goal
    if goal is None:
        ax.set_axis_off()
        ax.set_title("no goal", fontsize=FONT, color=INK)
        return
    _draw_table(ax, planner)
    draw_cells(ax, planner.obj, pose=goal.pose, alpha=0.6)
    hull = calc_support_polygon(planner.obj, goal.pose, planner.surface, planner.options.goal.inset)
    for p_BP, color, label in (
        (hull, HOLDS, "what holds it"),
        (masses.center_of_mass_polygon, BEFORE, "where the center of mass may be"),
        (goal.part.footprint, GRASP, "gripper"),
    ):
        if len(p_BP):
            ax.add_patch(
                Polygon(_place(p_BP, goal.pose), facecolor=f"{color}33", edgecolor=color, linewidth=1.4, label=label)
            )
    outline = shapely.Polygon(_place(np.asarray(planner.obj.outline.exterior.coords), goal.pose)).bounds
    _frame(ax, (outline[0] - CLOSE_UP, outline[1] - CLOSE_UP, outline[2] + CLOSE_UP, outline[3] + CLOSE_UP))
    ax.legend(fontsize=FONT - 1, frameon=False, loc="upper left")
    ax.set_title(
        f"{goal.margin * MM:.0f} mm to spare at the worst; {goal.part.width * MM:.0f} mm between the jaws",
        fontsize=FONT, color=INK,
    )  # fmt: skip


def _draw_table(ax: Axes, planner: PreGraspPlanner) -> None:
    ax.add_patch(Polygon(planner.surface.corners, facecolor=TABLE, edgecolor=FAINT, linewidth=1.0, zorder=0))


def _draw_push(ax: Axes, push: Push, color: str) -> None:
    ax.plot(*push.xy.T, color=color, linewidth=1.2)
    ax.add_patch(Circle((push.xy[0, 0], push.xy[0, 1]), push.radius, facecolor="none", edgecolor=color))
    ax.add_patch(Circle((push.xy[-1, 0], push.xy[-1, 1]), push.radius, facecolor=color, edgecolor=color))


def _frame(ax: Axes, bounds: tuple[float, float, float, float]) -> None:
    ax.set_xlim(bounds[0], bounds[2])
    ax.set_ylim(bounds[1], bounds[3])
    ax.set_aspect("equal", adjustable="box")


def _place(p_BP: NDArray[np.float64], pose: ArrayLike) -> NDArray[np.float64]:
    x, y, theta = np.asarray(pose, dtype=np.float64)
    c, s = np.cos(theta), np.sin(theta)
    return p_BP @ np.array([[c, s], [-s, c]]) + (x, y)
