"""Objects that lie elsewhere in each run: a scenario's `scatter`, for campaigns of many seeds.

Each object is moved from its pose in the scenario by as much as `scatter` allows, drawn from the
seed, so that it lies well on the table, within the workspace, and beside everything else. Nothing
here says what objects weigh; that is drawn by `station.scene.contents` and
`station.scene.other_objects`.
"""

from collections.abc import Sequence

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import ScenarioError
from gridpush_drake.geometry.se2 import transform_shape
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.station.scene.posts import place_posts
from gridpush_drake.station.schema.scenario import PushScenario, ScatterConfig

MIN_OBJECT_GAP = 0.003
"""Least distance of a scattered object from any other, and from a post, m."""

MIN_EDGE_DISTANCE = 0.04
"""Least distance of a scattered object from the table's edge, m: nothing begins at the edge."""

MAX_POSE_TRIES = 2000
"""Number of poses that are drawn for an object before it is given up."""

RANDOM_STREAM = 7
"""Sets the draw of poses apart from everything else that is drawn from the scenario's seed."""


def scatter_objects(
    scenario: PushScenario, obj: GridObject, others: Sequence[GridObject], table: BaseGeometry
) -> PushScenario:
    """Draws where the objects of a scenario lie; without `scatter` they lie where it has them.

    Args:
        scenario: the scenario; it is not changed.
        obj: its object.
        others: the other objects on the table, in its order.
        table: the table's top, a polygon in W, m.

    Returns:
        The scenario with the drawn poses, or itself if nothing is scattered.

    Raises:
        ScenarioError: an object has no room.
    """
    spread = np.array([scenario.scatter.distance] * 2 + [scenario.scatter.turn])
    if not spread.any():
        return scenario
    rng = np.random.default_rng((scenario.seed, RANDOM_STREAM))
    room = table.buffer(-MIN_EDGE_DISTANCE)
    taken = list(place_posts(scenario.posts))
    workspace = scenario.workspace
    box = shapely.box(workspace.x[0], workspace.y[0], workspace.x[1], workspace.y[1])

    # One after another, beside those before.
    poses = []
    fields = [scenario.names.name_field(number, "pose") for number in range(len(others) + 1)]
    begin = [scenario.object_pose, *(config.pose for config in scenario.others)]
    for field, each, middle in zip(fields, (obj, *others), begin, strict=True):
        for _ in range(MAX_POSE_TRIES):
            pose = np.array(middle) + spread * rng.uniform(-1.0, 1.0, 3)
            outline = transform_shape(pose, each.outline)
            free = shapely.union_all(taken).distance(outline) >= MIN_OBJECT_GAP if taken else True
            if free and room.covers(outline) and box.covers(shapely.Point(pose[:2])):
                break
        else:
            raise ScenarioError(
                f"scatter: no place was found for {each.name} near {field} in {MAX_POSE_TRIES} "
                "tries; "
                "expected room on the table and in the workspace, beside the other objects"
            )
        poses.append(pose.tolist())
        taken.append(outline)
    moved = [
        config.model_copy(update={"pose": pose})
        for config, pose in zip(scenario.others, poses[1:], strict=True)
    ]
    # Drawn once: who resolves the drawn scenario again finds the objects where they lie.
    drawn = {"object_pose": poses[0], "others": moved, "scatter": ScatterConfig()}
    return scenario.model_copy(update=drawn)
