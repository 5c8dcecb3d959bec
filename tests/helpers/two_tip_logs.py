"""Small logs of pushes by two tips, in the forms that their importers read."""

from pathlib import Path

import numpy as np

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.geometry.se2 import Array, compose, invert
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.importers.two_point import TWO_TIPS

RUNS_HEADER = "task,repeat,t,object_x,object_y,object_theta,robot_x,robot_y,robot_theta,action"
"""Header of a table of runs."""

FINGERS = PusherShape.discs([(0.0, -0.009), (0.0, 0.009)], 0.0025)
"""The fingers of such runs, as the importer has them by default."""

SIDES = np.array([(-0.028, 0.0, 0.0), (0.0, 0.0205, -np.pi / 2), (0.028, 0.0, np.pi)])
"""Poses of the fingers in the object's frame where they begin to push its sides, m and rad."""

ROW_TIME = 0.1
"""Time between two rows of a table of runs, s."""

ROWS = 12
"""Number of rows of a push on its way."""

DELAY_ROWS = 1
"""By how many rows the camera is late."""


def describe_two_point(
    name: str,
    before: Array,
    after: Array,
    angle: float,
    *,
    stable: int = 1,
    usable: int = 1,
    rows: int = 5,
) -> list[str]:
    """Writes a two-point push: the tool turns about (-0.05, 0.1) from (-0.05, 0), block's frame."""
    lines = [f"{name} rotation {stable} {usable}"]
    for pose in (before, after):
        lines.append(" ".join(map(repr, pose.tolist())))
    lines += [f"-0.05 0 1 0 -0.05 0.1 {angle} 0 1", str(rows)]
    tool = make_tool_path(angle, rows)
    for t, frame in zip(np.linspace(10.0, 14.0, rows), tool, strict=True):
        lines.append(" ".join(map(repr, [float(t), *compose(before, frame).tolist()])))
    return [*lines, "2", "10.0 0 0", "11.0 0.5 -0.25"]


def make_tool_path(angle: float, rows: int) -> Array:
    """Makes the tool's poses (rows, 3) in the block's frame, m and rad."""
    turn = np.linspace(0, angle, rows)
    return np.column_stack([-0.05 + 0.1 * np.sin(turn), 0.1 - 0.1 * np.cos(turn), turn])


def simulate_two_point(model: Model, angle: float, rows: int = 5) -> Array:
    """Simulates where such a push ends, (3,), in the block's frame."""
    path = make_tool_path(angle, rows)
    push = Push.along(np.linspace(0, 4, rows), path[:, :2], shape=TWO_TIPS, yaw=path[:, 2])
    return simulate(model, push, regime="quasi_static").final_pose


def write_two_point(path: Path, pushes: list[list[str]]) -> Path:
    """Writes a file of two-point pushes."""
    lines = [str(len(pushes)), *(line for push in pushes for line in push)]
    path.write_text("\n".join(lines) + "\n")
    return path


def simulate_run(
    model: Model, task: str, repeat: int, turns: list[float], X_RC: Array
) -> list[str]:
    """Simulates a run: the fingers push one side after the other ahead, turning on the way.

    Args:
        model: a rectangle of 0.05 by 0.035 m.
        task: name of the task.
        repeat: number of the run.
        turns: how far the fingers turn in each push, rad.
        X_RC: (3,) where the camera's frame is in the robot's, m and rad.
    """
    lines = []
    begin = 0.0
    pose = np.array([0.01 * repeat, 0.3, 1.1 * repeat])
    for action, turn in enumerate(turns, start=1):
        start = compose(pose, SIDES[(repeat + action) % len(SIDES)])
        ahead = np.linspace(0, 1, ROWS)
        steps = np.column_stack([0.04 * ahead, 0.02 * turn * ahead**2, turn * ahead])
        robot = compose(start, steps)
        push = Push.along(ROW_TIME * np.arange(ROWS), robot[:, :2], shape=FINGERS, yaw=robot[:, 2])
        motion = simulate(model, push, pose, regime="quasi_static")
        path = np.column_stack([np.interp(push.t, motion.times, q) for q in motion.poses.T])
        # the fingers stand before and after, and what is seen is late
        still = 2 + DELAY_ROWS
        frames = np.concatenate([robot[:1].repeat(still, 0), robot, robot[-1:].repeat(still, 0)])
        poses = np.concatenate(
            [path[:1].repeat(still + DELAY_ROWS, 0), path, path[-1:].repeat(still - DELAY_ROWS, 0)]
        )
        for i, (frame, seen) in enumerate(zip(frames, compose(invert(X_RC), poses), strict=True)):
            # no two poses are told alike, as a camera's are not
            told = seen + [1e-7 * i, 0, 0]
            numbers = ",".join(f"{value:.8f}" for value in (*told, *frame))
            lines.append(f"{task},{repeat},{begin + ROW_TIME * i:.3f},{numbers},{action}")
        begin += ROW_TIME * len(frames) + 5.0
        pose = motion.final_pose
    return lines


def write_runs(path: Path, obj: GridObject, lines: list[str]) -> Path:
    """Writes a table of runs, and the object's outline beside."""
    path.write_text("\n".join([RUNS_HEADER, *lines]) + "\n")
    corners = "\n".join(f"{x},{y}" for x, y in list(obj.outline.exterior.coords)[:-1])
    path.with_name(f"{path.stem}_outline.csv").write_text(f"x,y\n{corners}\n")
    return path
