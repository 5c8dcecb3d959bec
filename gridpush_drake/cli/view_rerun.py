"""What `gridpush view --rerun` shows: a learned model, replayed pushes, or a recorded run."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from gridpush_drake.cli.options import Target
from gridpush_drake.cli.view_scene import HOLD, PLAIN_COLOR
from gridpush_drake.display.cell_colors import CellColors, Shown
from gridpush_drake.display.rerun_scene import MILLIMETERS, RerunScene
from gridpush_drake.geometry.se2 import Array, make_rotation
from gridpush_drake.identification.prediction import Prediction
from gridpush_drake.pushes.push_log import DEFAULT_PUSHER_RADIUS, ObservedPush, PushLog
from gridpush_drake.station.run_recorder import PICTURE_TOPIC, SEEN_SIZE
from gridpush_drake.station.run_recording import RunRecording, read_planar_pose, read_point

OBJECT = "world/object"
"""Entity of the object."""

POSE = "/object_pose"
"""Topic of a recording that has the object's poses."""

PREDICTED = "world/predicted"
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
        scene.show_outline(np.array(target.obj.outline.exterior.coords)[:-1], PREDICTED)
    begin = 0.0
    for i, seen in enumerate(log):
        scene.set_time(begin)
        scene.say(seen.name)
        scene.show_push(seen.push.xy[0], seen.push.xy[-1])
        prediction = None if predictions is None else predictions[i]
        for time, shown in _list_moments(seen, prediction):
            scene.set_time(begin + time)
            if shown is seen.push:
                scene.show_tip(np.append(seen.push.tip_at(time - HOLD), 0.0), seen.push.radius)
            elif isinstance(shown, tuple):
                entity, pose = shown
                scene.show_object(pose, entity)
        if prediction is not None:
            _plot_error(scene, target, seen, prediction)
        begin += HOLD + seen.push.duration + HOLD


def _list_moments(seen: ObservedPush, prediction: Prediction | None) -> list[tuple[float, Any]]:
    """Lists what moves in a push, in the order of times.

    Returns:
        Times, s, from `HOLD` before the push begins. With each the push, of which the tip moved; or
        an entity and its pose (3,), m and rad.
    """
    moments: list[tuple[float, Any]] = [(HOLD + float(t), seen.push) for t in seen.push.t]
    times = np.append(0.0, seen.t_observed)
    poses = np.vstack([seen.pose, seen.poses_observed])
    moments += [(HOLD + float(t), (OBJECT, pose)) for t, pose in zip(times, poses, strict=True)]
    moments.append((0.0, (OBJECT, seen.pose)))
    if prediction is not None:
        motion = zip(prediction.times, prediction.poses, strict=True)
        moments += [(HOLD + float(t), (PREDICTED, pose)) for t, pose in motion]
        moments.append((0.0, (PREDICTED, prediction.poses[0])))
    return sorted(moments, key=lambda moment: moment[0])


def _plot_error(
    scene: RerunScene, target: Target, seen: ObservedPush, prediction: Prediction
) -> None:
    """Adds how far the cells ended from where they were predicted, on average, to a curve."""
    there, expected = target.obj.cells_at(np.vstack([seen.final_pose, prediction.poses[-1]]))
    error = float(np.linalg.norm(there - expected, axis=1).mean())
    scene.plot("predicted/cell_error_mm", MILLIMETERS * error)


def _show_target(scene: RerunScene, target: Target, shows: Shown) -> None:
    """Shows the cells, and of a learned model the center of mass."""
    obj = target.obj
    if target.model is None:
        scene.show_cells(obj.p_BC, obj.cell_size, np.tile(PLAIN_COLOR, (obj.n, 1)))
        return
    colors = CellColors(shows).calc_colors(target.params.mass, target.params.friction)
    scene.show_estimate(target.model, colors)


def show_run(scene: RerunScene, run: RunRecording) -> None:
    """Shows a recorded run: everything that is in the file, at the times when it was so.

    Args:
        scene: where it is shown.
        run: the recording.

    Raises:
        RecordingError: the recording has no poses of the object.
    """
    run.require(POSE)
    shown = _Shown(scene)
    moments = [
        (time, topic, message)
        for topic, messages in run.topics.items()
        for time, message in messages
    ]
    # Of what was so at the same time, the object's pose comes first: the rest may be relative to it
    moments.sort(key=lambda moment: (moment[0], moment[1] != POSE))
    for time, topic, message in moments:
        scene.set_time(time)
        shown.show(topic, message)


class _Shown:
    """Shows one message after the other."""

    def __init__(self, scene: RerunScene) -> None:
        self._scene = scene
        self._pose: Array | None = None
        self._pushes = 0

    def show(self, topic: str, message: Any) -> None:
        """Shows a message of a topic."""
        scene = self._scene
        if topic == POSE:
            self._pose = read_planar_pose(message.pose)
            scene.show_object(self._pose)
        elif topic == "/tip_pose":
            scene.show_tip(read_point(message.pose.position), DEFAULT_PUSHER_RADIUS)
        elif topic == "/push":
            self._pushes += 1
            start, end = (read_point(pose.pose.position)[:2] for pose in message.poses)
            scene.show_push(start, end)
        elif topic == "/center_of_mass":
            self._show_center(message.pose)
        elif topic == "/cells":
            self._show_cells(message)
        elif topic == "/phase":
            scene.say(message.data)
        elif topic == PICTURE_TOPIC:
            scene.show_picture(message.data.tobytes())
        elif topic == "/wrench":
            force = float(np.linalg.norm(read_point(message.wrench.force)))
            scene.plot("felt/force_n", force)
        elif topic == "/joint_states":
            for name, position in zip(message.name, message.position, strict=True):
                scene.plot(f"joints/{name}", float(position))

    def _show_center(self, message: Any) -> None:
        """The center of mass, which the message has in W, in the body frame."""
        if self._pose is None:
            return
        covariance = np.asarray(message.covariance).reshape(6, 6)[:2, :2]
        R = make_rotation(self._pose[2])
        center = R.T @ (read_point(message.pose.position)[:2] - self._pose[:2])
        self._scene.show_center(center, R.T @ covariance @ R)
        self._scene.plot("known/pushes", float(self._pushes))

    def _show_cells(self, message: Any) -> None:
        for marker in message.markers:
            points = np.array([read_point(point)[:2] for point in marker.points])
            colors = np.array([[color.r, color.g, color.b] for color in marker.colors])
            self._scene.show_cells(points, marker.scale.x / SEEN_SIZE, colors)
