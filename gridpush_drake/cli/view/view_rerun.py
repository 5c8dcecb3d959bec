"""What `gridpush view --rerun` shows of a learned model and of replayed pushes.

A recorded run is shown by `station.recording.rerun_replay`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gridpush_drake.cli.shell.options import Target
from gridpush_drake.cli.view.view_scene import END_POSE_TIME, PLAIN_COLOR
from gridpush_drake.display.cell_colors import CellColors, Shown
from gridpush_drake.display.rerun_scene import RerunScene
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.prediction import Prediction
from gridpush_drake.pushes.push_log import ObservedPush, PushLog
from gridpush_drake.units import MM_PER_M

OBJECT_ENTITY = "world/object"
"""Entity of the object."""

TIP_ENTITY = "world/tip"
"""Entity of the finger's tip."""

PREDICTED_ENTITY = "world/predicted"
"""Entity of the object as the model predicts it."""


def show_model(scene: RerunScene, target: Target, shows: Shown) -> None:
    """Shows a model at rest in its body frame.

    Args:
        scene: where it is shown.
        target: the model, or an object of which nothing was learned.
        shows: what the colors of the cells stand for.
    """
    scene.set_time(0.0)
    scene.show_object(np.zeros(3))
    _show_target(scene, target, shows)


def show_pushes(
    scene: RerunScene,
    target: Target,
    log: PushLog,
    predictions: Sequence[Prediction] | None,
    shows: Shown,
) -> None:
    """Shows pushes, one after the other, and the object as it was observed and as predicted.

    Args:
        scene: where they are shown.
        target: the model or object that was pushed.
        log: the pushes.
        predictions: the predicted motion of each push, in the order of the log; None for none.
        shows: what the colors of the cells stand for.
    """
    scene.set_time(0.0)
    _show_target(scene, target, shows)
    if predictions is not None:
        scene.show_outline(np.array(target.obj.outline.exterior.coords)[:-1], PREDICTED_ENTITY)
    begin = 0.0
    for i, seen in enumerate(log):
        prediction = None if predictions is None else predictions[i]
        scene.set_time(begin)
        scene.say(seen.name)
        scene.show_push(
            start=seen.push.xy[0],
            end=seen.push.xy[-1],
        )
        # The first poses are held for a while, so that one sees where the push begins
        scene.show_object(seen.pose, OBJECT_ENTITY)
        if prediction is not None:
            scene.show_object(prediction.poses[0], PREDICTED_ENTITY)

        # Then everything moves, each at times of its own
        for move in _list_moves(seen, prediction):
            scene.set_time(begin + END_POSE_TIME + move.time)
            if move.entity == TIP_ENTITY:
                push = seen.push
                tip = np.append(move.place[:2], 0.0)
                scene.show_tip(tip, push.radius, push.shape, float(move.place[2]))
            else:
                scene.show_object(move.place, move.entity)
        if prediction is not None:
            _plot_error(scene, target, seen, prediction)
        begin += END_POSE_TIME + seen.push.duration + END_POSE_TIME


@dataclass(frozen=True, eq=False)
class _Move:
    """Where something is at a time.

    Attributes:
        time: since the push began, s.
        entity: what moved.
        place: (3,) planar pose of the tip or of the object, m and rad.
    """

    time: float
    entity: str
    place: Array


def _list_moves(seen: ObservedPush, prediction: Prediction | None) -> list[_Move]:
    """Lists what moves in a push, in the order of times."""
    moves = []
    for time in seen.push.t:
        tip = np.append(seen.push.tip_at(time), seen.push.yaw_at(time))
        moves.append(_Move(float(time), TIP_ENTITY, tip))
    for time, pose in zip(seen.t_observed, seen.poses_observed, strict=True):
        moves.append(_Move(float(time), OBJECT_ENTITY, pose))
    if prediction is not None:
        for time, pose in zip(prediction.times, prediction.poses, strict=True):
            moves.append(_Move(float(time), PREDICTED_ENTITY, pose))
    return sorted(moves, key=lambda move: move.time)


def _plot_error(
    scene: RerunScene, target: Target, seen: ObservedPush, prediction: Prediction
) -> None:
    """Adds how far the cells ended from where they were predicted, on average, to a curve."""
    ends = np.vstack([seen.final_pose, prediction.poses[-1]])
    there, expected = target.obj.cells_at(ends)
    distances = np.linalg.norm(there - expected, axis=1)
    error = float(distances.mean())
    scene.plot("predicted/cell_error_mm", MM_PER_M * error)


def _show_target(scene: RerunScene, target: Target, shows: Shown) -> None:
    """Shows the cells, and of a learned model the center of mass."""
    obj = target.obj
    if target.model is None:
        scene.show_cells(
            p_BC=obj.p_BC,
            side=obj.cell_size,
            colors=np.tile(PLAIN_COLOR, (obj.n, 1)),
        )
        return
    colors = CellColors(shows).calc_colors(
        mass=target.params.mass,
        friction=target.params.friction,
    )
    scene.show_estimate(target.model, colors)
