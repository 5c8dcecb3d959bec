"""Figures of plans and runs: pushing to a goal, sliding to the table's edge, grasping there."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike
from shapely import Polygon as Shape

from gridpush_drake.dynamics.push import Push
from gridpush_drake.geometry.se2 import Array, make_direction, transform
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import speak_name
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.goal.push_plan import PushPlan
from gridpush_drake.planning.plausible_masses import PlausibleMassSet
from gridpush_drake.planning.pregrasp.grasp.grasp_parts import FlatPart
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.planning.pregrasp.pregrasp_plan import PreGraspPlan
from gridpush_drake.planning.pregrasp.stability import SUPPORT_INSET, calc_support_polygon
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.report.draw import (
    FAINT_COLOR,
    FONT_SIZE,
    INK_COLOR,
    LEARNED_COLOR,
    PAGE_WIDTH,
    PRIOR_COLOR,
    add_legend_below,
    draw_arrow,
    draw_cells,
    draw_numbered_push,
    draw_outline,
    draw_table,
    draw_tips,
    frame_points,
    make_chart,
    make_grid,
    tidy,
)
from gridpush_drake.units import MM_PER_M

HOLDING_COLOR = "#4f9d69"
"""Color of what holds the object."""

GRASP_COLOR = "#b3423f"
"""Color of what the gripper takes."""

OBSTACLE_COLOR = "#c7bdb0"
"""Color of what is in the way."""

FIGURE_WIDTH = 6.5
"""Width of a plan's figure, inches."""

MAX_HEIGHT = 7.5
"""Largest height of a plan's drawing, inches."""

LEGEND_ROOM = 0.7
"""Room below a plan's drawing for its legend, inches."""

PANEL_HEIGHT = 4.4
"""Height of figures with two panels, inches."""

FIGURE_MARGIN = 0.05
"""Room about what is drawn, m."""

CLOSE_UP = 0.06
"""Room about an object in a close-up, m."""

JAW_LENGTH = 0.08
"""Length of the gripper's fingers as drawn, m."""

JAW_WIDTH = 0.02
"""Width of the gripper's fingers as drawn, m."""


def draw_plan(
    obj: GridObject,
    plan: PushPlan,
    surface: SupportSurface | None = None,
    obstacles: Sequence[Shape] = (),
) -> Figure:
    """Draws a plan's pushes; of a plan without any, start and goal alone.

    Args:
        obj: the object.
        plan: the plan.
        surface: the table; None for one without end.
        obstacles: what is in the way, world frame, m.
    """
    poses = plan.poses
    pushes = [planned.push for planned in plan.pushes]
    shapes = [np.array(obstacle.exterior.coords)[:, :2] for obstacle in obstacles]
    points = [
        obj.cells_at(np.array([*poses, plan.goal])).reshape(-1, 2),
        *(push.xy for push in pushes),
        *shapes,
    ]
    if surface is not None:
        points.append(surface.corners)
    width, height = np.ptp(np.concatenate(points), axis=0) + 2 * FIGURE_MARGIN
    figure, ax = make_chart(
        FIGURE_WIDTH, min(FIGURE_WIDTH * height / width, MAX_HEIGHT) + LEGEND_ROOM
    )
    for shape in shapes:
        ax.add_patch(Polygon(shape, facecolor=OBSTACLE_COLOR, edgecolor=INK_COLOR, zorder=0.5))
    _draw_pushes(ax, obj, poses, pushes, plan.goal, surface, "predicted end")
    frame_points(ax, points, FIGURE_MARGIN)
    count = f"{len(pushes)} push{'' if len(pushes) == 1 else 'es'}"
    words = plan.status.replace("_", " ")
    ax.set_title(
        f"{speak_name(obj.name)}: {words}, {count}, {plan.error * MM_PER_M:.1f} mm left",
        fontsize=FONT_SIZE,
        color=INK_COLOR,
    )
    return figure


def draw_push_run(
    obj: GridObject,
    poses: Sequence[ArrayLike],
    pushes: Sequence[Push],
    goal: ArrayLike,
    surface: SupportSurface | None = None,
    *,
    expected: Sequence[float] = (),
    tolerance: float | None = None,
) -> Figure:
    """Draws a run: on the left the path to the goal, on the right how far the object was from it.

    Args:
        obj: the object.
        poses: (3,) where it was seen at rest, X_WB, m and rad: before the first push, and after
            each.
        pushes: as they were made; as many as poses, less one.
        goal: (3,) where it should lie.
        surface: the table; None for one without end.
        expected: of each push, the mean cell error to the goal that was expected after it, m; empty
            for unknown.
        tolerance: mean cell error at which the goal counts as reached, m; None is not drawn.

    Returns:
        The figure.
    """
    figure, axes = make_grid(1, 2, PAGE_WIDTH, PANEL_HEIGHT)
    rest = np.array([np.asarray(pose, dtype=np.float64) for pose in poses])
    aim = np.asarray(goal, dtype=np.float64)
    ax = axes[0, 0]
    _draw_pushes(ax, obj, rest, pushes, aim, surface, "at the end")
    cells = obj.cells_at(np.vstack([rest, aim])).reshape(-1, 2)
    frame_points(ax, [cells, *(push.xy for push in pushes)], FIGURE_MARGIN)
    ax.set_title("The path to the goal", fontsize=FONT_SIZE, color=INK_COLOR)
    _draw_errors(axes[0, 1], np.atleast_1d(calc_goal_error(obj, rest, aim)), expected, tolerance)
    return figure


def _draw_pushes(
    ax: Axes,
    obj: GridObject,
    poses: Sequence[Array] | Array,
    pushes: Sequence[Push],
    goal: Array,
    surface: SupportSurface | None,
    end: str,
) -> None:
    """Draws the object from its first pose to its last, the numbered pushes, and the goal.

    The legend calls the last pose `end`.
    """
    _draw_outlines(ax, obj, poses, surface)
    if len(poses) > 1:
        draw_cells(ax, obj, pose=poses[-1], alpha=0.7)
    draw_outline(ax, obj, pose=goal, color=PRIOR_COLOR, linestyle="dotted").set_zorder(4)
    for count, push in enumerate(pushes, start=1):
        draw_numbered_push(ax, push, count, LEARNED_COLOR)
    handles = [
        Line2D([], [], color=INK_COLOR, linestyle="dashed", label="start"),
        Line2D([], [], color=FAINT_COLOR, label="in between"),
        Line2D([], [], color=INK_COLOR, label=end),
        Line2D([], [], color=PRIOR_COLOR, linestyle="dotted", label="goal"),
        Line2D([], [], color=LEARNED_COLOR, marker="o", markerfacecolor="white", label="pushes"),
    ]
    add_legend_below(ax, handles, 3)


def _draw_outlines(
    ax: Axes, obj: GridObject, poses: Sequence[Array] | Array, surface: SupportSurface | None
) -> None:
    """Draws the table, and the object's outline at all its poses but the last.

    The first one is dashed, the others are faint.
    """
    if surface is not None:
        draw_table(ax, surface.corners)
    for pose in poses[1:-1]:
        draw_outline(ax, obj, pose=pose, color=FAINT_COLOR)
    draw_outline(ax, obj, pose=poses[0], color=INK_COLOR, linestyle="dashed")


def _draw_errors(
    ax: Axes, errors: Array, expected: Sequence[float], tolerance: float | None
) -> None:
    """Draws the errors to the goal (P+1,), seen and expected, m, and the tolerance, m."""
    ax.plot(np.arange(len(errors)), MM_PER_M * errors, color=LEARNED_COLOR, marker="o", zorder=3)
    handles = [Line2D([], [], color=LEARNED_COLOR, marker="o", label="seen")]
    if len(expected):
        marks: dict[str, Any] = {
            "color": PRIOR_COLOR,
            "marker": "D",
            "markerfacecolor": "white",
            "linestyle": "none",
        }
        ax.plot(np.arange(1, len(expected) + 1), MM_PER_M * np.asarray(expected), zorder=4, **marks)
        handles.append(Line2D([], [], label="expected", **marks))
    if tolerance is not None:
        ax.axhline(
            MM_PER_M * tolerance, color=FAINT_COLOR, linestyle="dashed", linewidth=1.2, zorder=2
        )
        handles.append(Line2D([], [], color=FAINT_COLOR, linestyle="dashed", label="near enough"))
    ax.set_ylim(bottom=0.0)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    tidy(ax, "pushes made", "mean cell error to the goal, mm")
    add_legend_below(ax, handles, 3)
    ax.set_title("How far it was from the goal", fontsize=FONT_SIZE, color=INK_COLOR)


def draw_slide(planner: PreGraspPlanner, masses: PlausibleMassSet, plan: PreGraspPlan) -> Figure:
    """Draws a plan: on the left the path, on the right the goal.

    At the goal it is seen what holds the object, and what hangs over.

    Args:
        planner: object, table and options.
        masses: the masses that stability was judged on.
        plan: the plan; where nothing is safe, its safest goal is drawn.
    """
    figure, axes = make_grid(1, 2, PAGE_WIDTH, PANEL_HEIGHT)
    ax = axes[0, 0]
    _draw_outlines(ax, planner.obj, plan.poses, planner.surface)
    draw_cells(ax, planner.obj, pose=plan.poses[-1])
    for push in plan.pushes:
        draw_tips(ax, push, LEARNED_COLOR)
    if plan.poke is not None:
        draw_tips(ax, plan.poke, PRIOR_COLOR)
    frame_points(ax, [planner.surface.corners], CLOSE_UP)
    count = len(plan.pushes)
    ax.set_title(
        f"{plan.status}: {count} push{'' if count == 1 else 'es'}",
        fontsize=FONT_SIZE,
        color=INK_COLOR,
    )
    _draw_goal(axes[0, 1], planner, masses, plan)
    return figure


def _draw_goal(
    ax: Axes, planner: PreGraspPlanner, masses: PlausibleMassSet, plan: PreGraspPlan
) -> None:
    """Draws the object at a plan's goal, what holds it, and what the gripper takes."""
    goal = plan.goal
    if goal is None:
        ax.set_axis_off()
        ax.set_title("no goal", fontsize=FONT_SIZE, color=INK_COLOR)
        return
    draw_table(ax, planner.surface.corners)
    draw_cells(ax, planner.obj, pose=goal.pose, alpha=0.6)
    hull = calc_support_polygon(planner.obj, goal.pose, planner.surface, planner.options.goal.inset)
    areas = (
        (hull, HOLDING_COLOR, "what holds it"),
        (masses.center_of_mass_polygon, PRIOR_COLOR, "where the center of mass may be"),
        (goal.part.footprint, GRASP_COLOR, "gripper"),
    )
    handles = _draw_areas(ax, goal.pose, areas)
    frame_points(
        ax, [transform(goal.pose, np.asarray(planner.obj.outline.exterior.coords)[:, :2])], CLOSE_UP
    )
    add_legend_below(ax, handles, 2)
    flat = isinstance(goal.part, FlatPart)
    how = "taken by the rim" if flat else f"{goal.part.width * MM_PER_M:.0f} mm between the jaws"
    room = (
        f"{abs(goal.margin) * MM_PER_M:.0f} mm {'to spare' if goal.margin >= 0 else 'too little'}"
    )
    ax.set_title(f"at the worst {room},\n{how}", fontsize=FONT_SIZE, color=INK_COLOR)


class PushDrawn(NamedTuple):
    """A push as it was made.

    Attributes:
        start: (2,) the finger's center where the push began, world frame, m.
        end: (2,) the finger's center where it ended, world frame, m.
        poke: whether the push was made to learn from it.
    """

    start: Array
    end: Array
    poke: bool


class GraspDrawn(NamedTuple):
    """A grasp as it was made.

    Attributes:
        point: (2,) p_WG, the grasp point, m.
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
    """Draws a run: on the left the object's path, on the right the object as it lay at the end.

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
    ax = axes[0, 0]
    _draw_outlines(ax, obj, poses, surface)
    draw_cells(ax, obj, pose=poses[-1])
    for push in pushes:
        draw_arrow(ax, push.start, push.end, PRIOR_COLOR if push.poke else LEARNED_COLOR)
    frame_points(
        ax,
        [*(obj.cells_at(pose) for pose in poses), *(np.array([p.start, p.end]) for p in pushes)],
        CLOSE_UP,
    )
    handles = [
        Line2D([], [], color=INK_COLOR, linestyle="dashed", label="start"),
        Line2D([], [], color=PRIOR_COLOR, marker=">", label="pokes"),
        Line2D([], [], color=LEARNED_COLOR, marker=">", label="slides"),
    ]
    add_legend_below(ax, handles, 2)
    ax.set_title("The path to the table's edge", fontsize=FONT_SIZE, color=INK_COLOR)
    _draw_end(axes[0, 1], obj, surface, poses[-1], masses, truth, grasp)
    return figure


def _draw_end(
    ax: Axes,
    obj: GridObject,
    surface: SupportSurface,
    pose: Array,
    masses: PlausibleMassSet,
    truth: CellParameters | None,
    grasp: GraspDrawn | None,
) -> None:
    """Draws the object as it lay at the end, what held it, and the grasp."""
    draw_table(ax, surface.corners)
    draw_cells(ax, obj, pose=pose, alpha=0.6)
    hull = calc_support_polygon(obj, pose, surface, SUPPORT_INSET)
    possible = masses.center_of_mass_polygon
    handles = _draw_areas(
        ax,
        pose,
        (
            (hull, HOLDING_COLOR, "what holds it"),
            (possible, PRIOR_COLOR, "where its center of mass may be"),
        ),
    )
    if truth is not None:
        (at,) = transform(pose, truth.center_of_mass(obj)[None])
        ax.plot(
            *at,
            marker="x",
            color=INK_COLOR,
            markersize=7,
            markeredgewidth=1.8,
            linestyle="none",
            zorder=6,
        )
        handles.append(
            Line2D([], [], color=INK_COLOR, marker="x", linestyle="none", label="where it truly is")
        )
    points = [obj.cells_at(pose)]
    if grasp is not None:
        jaw = _make_jaw(grasp)
        ax.add_patch(
            Polygon(
                jaw, facecolor=f"{GRASP_COLOR}55", edgecolor=GRASP_COLOR, linewidth=1.2, zorder=4
            )
        )
        ax.add_patch(
            Circle((grasp.point[0], grasp.point[1]), JAW_WIDTH / 4, color=GRASP_COLOR, zorder=5)
        )
        handles.append(Line2D([], [], color=GRASP_COLOR, label="gripper"))
        points.append(jaw)
    frame_points(ax, points, CLOSE_UP)
    add_legend_below(ax, handles, 2)
    ax.set_title(
        "Where it was grasped" if grasp is not None else "Where it lay at the end",
        fontsize=FONT_SIZE,
        color=INK_COLOR,
    )


def _make_jaw(grasp: GraspDrawn) -> Array:
    """Makes the corners (4, 2) of the fingers, m, with their tips just beyond the grasp point."""
    along = make_direction(grasp.approach)
    across = np.array([-along[1], along[0]]) * JAW_WIDTH / 2
    tip = grasp.point + JAW_WIDTH * 0.75 * along
    root = grasp.point - (JAW_LENGTH - JAW_WIDTH) * along
    return np.array([tip + across, tip - across, root - across, root + across])


def _draw_areas(ax: Axes, pose: Array, areas: Sequence[tuple[Array, str, str]]) -> list[Line2D]:
    """Draws areas in their colors.

    Args:
        ax: where to draw, world frame, m.
        pose: (3,) the object's, m and rad.
        areas: corners (k, 2) of each area, body frame, m, its color, and its name.

    Returns:
        Entries of a legend, for the areas that are not empty.
    """
    handles = []
    for p_BP, color, label in areas:
        if len(p_BP):
            ax.add_patch(
                Polygon(
                    transform(pose, p_BP), facecolor=f"{color}33", edgecolor=color, linewidth=1.4
                )
            )
            handles.append(Line2D([], [], color=color, label=label))
    return handles
