"""What `gridpush view --with` shows: pushes of several objects, beside their predictions."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat

from gridpush_drake.cli.console import MM, count_noun
from gridpush_drake.cli.options import Target
from gridpush_drake.cli.view_scene import (
    FRAMES_PER_SECOND,
    HOLD,
    PLAIN_COLOR,
    AddPusher,
    FrameScene,
    RecordPoses,
    list_push_phases,
    sample_times,
)
from gridpush_drake.display.cell_colors import CellColors, Shown
from gridpush_drake.display.overlay import Mark, Overlay, list_center_marks, to_css
from gridpush_drake.display.shapes import LAYER, PLAN_COLOR, AddCells, AddCenter, AddGhost
from gridpush_drake.dynamics.motion import Motion
from gridpush_drake.dynamics.scene.simulation import simulate_together
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.joint_fit import calc_end_errors
from gridpush_drake.identification.model import Model
from gridpush_drake.pushes.observed_push import ObservedPush
from gridpush_drake.pushes.push_log import PushLog

OBJECTS = "objects"
"""Path in Meshcat below which each object has its number."""

GHOSTS = "predicted"
"""Path in Meshcat of the objects as the models predict them, likewise."""


def make_bodies(targets: Mapping[str, Target], log: PushLog) -> Model | None:
    """Makes the model by which a log's pushes are predicted.

    The friction between objects is the default one, for a model's file does not hold it.

    Args:
        targets: the objects, by the names that they have in the log.
        log: the pushes.

    Returns:
        The objects; None where not all of them are learned.
    """
    ordered = [targets[name] for name in log.names]
    if any(target.model is None for target in ordered):
        return None
    return Model([target.obj for target in ordered], [target.params for target in ordered])


def predict_scene(model: Model | None, log: PushLog) -> list[Motion] | None:
    """Predicts each push of a log; None where there is no model."""
    if model is None:
        return None
    return [simulate_together(model, seen.push, seen.pose) for seen in log]


def AddScenePushes(
    meshcat: Meshcat,
    targets: Mapping[str, Target],
    log: PushLog,
    motions: list[Motion] | None,
    shows: Shown,
    height: float,
) -> None:
    """Records a replay of pushes, one after the other; the caller has to publish it.

    Args:
        meshcat: where to draw it.
        targets: the objects, by the names that they have in the log.
        log: the pushes.
        motions: the predicted motions, which are drawn as ghosts; None for no ghosts.
        shows: what the colors of the cells stand for.
        height: height of the objects, m.
    """
    ordered = [targets[name] for name in log.names]
    colors = CellColors(shows)
    for b, target in enumerate(ordered):
        path = f"{OBJECTS}/{b}"
        drawn = np.tile(PLAIN_COLOR, (target.obj.n, 1))
        if target.model is not None:
            drawn = colors.calc_colors(target.params.mass, target.params.friction)
            center = target.params.center_of_mass(target.obj)
            covariance = target.model.identifiability.center_of_friction_covariance
            AddCenter(meshcat, f"{path}/center", center, covariance, height + LAYER)
        AddCells(meshcat, f"{path}/cells", target.obj, drawn, height)
        if motions is not None:
            AddGhost(meshcat, f"{GHOSTS}/{b}", target.obj, height)
    FrameScene(meshcat, _calc_extent(ordered, log))
    meshcat.StartRecording(FRAMES_PER_SECOND)
    begin = 0.0
    for i, seen in enumerate(log):
        AddPusher(meshcat, seen.push, i, begin, height)
        first = begin + HOLD
        end = first + seen.push.duration + HOLD
        times = np.append(0.0, seen.t_observed)
        observed = _list_observed(seen)
        for b in range(len(ordered)):
            RecordPoses(
                meshcat,
                f"{OBJECTS}/{b}",
                times=first + times,
                poses=observed[:, b],
                begin=begin,
                end=end,
            )
            if motions is None:
                continue
            at = sample_times(motions[i].times)
            places = np.searchsorted(motions[i].times, at)
            RecordPoses(
                meshcat,
                f"{GHOSTS}/{b}",
                times=first + at,
                poses=motions[i].poses[places, b],
                begin=begin,
                end=end,
            )
        begin = end
    meshcat.StopRecording()


def make_scene_overlay(log: PushLog, motions: list[Motion] | None) -> Overlay:
    """Makes the legend and the captions of the page.

    Args:
        log: the pushes.
        motions: the predicted motions; None if there are none.
    """
    marks = list_center_marks() if motions is not None else ()
    marks += (Mark(to_css(PLAN_COLOR), "the finger's push", "line"),)
    if motions is not None:
        marks += (
            Mark(to_css(PLAN_COLOR), "the objects as the models predict them; solid: as observed"),
        )
    return Overlay(None, marks, list_push_phases((seen.name, seen.push, "") for seen in log))


def describe_scene_pushes(model: Model | None, log: PushLog) -> tuple[dict[str, Any], list[str]]:
    """Says which pushes are shown, and how well they are predicted; for machines and in lines."""
    found: dict[str, Any] = {"kind": "pushes"}
    found["objects"] = list(log.names)
    found["pushes"] = [seen.name for seen in log]
    lines = [f"{', '.join(log.names)}: {count_noun(len(log), 'push')}"]
    if model is not None:
        errors = calc_end_errors(model, log)
        found["cell_errors"] = errors.tolist()
        lines.append("Solid: as observed. Orange: as the models predict it.")
        lines.append(f"Mean cell error of the final poses: {errors.mean() * MM:.1f} mm")
    return found, lines


def _list_observed(seen: ObservedPush) -> Array:
    """Lists all poses (K+1, N, 3) that were seen of a push, the first ones included."""
    return np.concatenate([seen.pose[None], seen.poses_observed])


def _calc_extent(targets: list[Target], log: PushLog) -> Array:
    """Returns the smallest and largest x, y (2, 2) of observed cells and finger paths, m."""
    points = [seen.push.xy for seen in log]
    for seen in log:
        observed = _list_observed(seen)
        for b, target in enumerate(targets):
            cells = target.obj.cells_at(observed[:, b])
            points.append(cells.reshape(-1, 2))
    together = np.concatenate(points)
    return np.array([together.min(axis=0), together.max(axis=0)])
