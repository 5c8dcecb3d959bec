"""What a player knows of an object beforehand: its shape.

It is given as arrays whose sizes are the same for every object.

A place on the outline is a fraction of its reachable length (`planning.contact.reachable_outline`),
from 0 to 1, so that the finger fits at every place.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import DEFAULT_PUSHER_RADIUS, Pusher
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array, check_vector, transform_back
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.planning.contact.reachable_outline import (
    ReachableOutline,
    find_reachable_outline,
)
from gridpush_drake.planning.contact.trial import ContactOptions
from gridpush_drake.planning.pregrasp.grasp.grasp_parts import GraspPart, find_grasp_parts

PLACE_COUNT = 64
"""Number of places on the outline that are observed."""

PICTURE_PIXELS = 48
"""Number of pixels of the occupancy picture along each side."""

PICTURE_SIDE = 0.48
"""Length of the picture's side, m."""

OCCUPIED_VALUE = 255
"""Value of a pixel within the object."""

FINGER_RADIUS = DEFAULT_PUSHER_RADIUS
"""Radius of the games' finger, whatever the objects' files say, m."""

FINGER_OPTIONS = ContactOptions(Pusher(FINGER_RADIUS), distance_range=(0.01, 0.15))
"""The finger and the pushes that it can make."""


@dataclass(frozen=True, eq=False)
class KnownShape:
    """An object as a player sees it.

    Attributes:
        obj: the object.
    """

    obj: GridObject

    def __post_init__(self) -> None:
        width = np.ptp(np.reshape(self.obj.outline.bounds, (2, 2)), axis=0).max()
        if width > PICTURE_SIDE:
            raise PlanningError(
                f"{self.obj.name}: is {width:.3g} m wide; expected at most {PICTURE_SIDE:g} m in "
                "these "
                "games"
            )

    @cached_property
    def reachable(self) -> ReachableOutline:
        """The part of the outline that the finger can touch."""
        return find_reachable_outline(self.obj, FINGER_RADIUS, FINGER_OPTIONS.pusher.clearance)

    @cached_property
    def outline(self) -> Array:
        """Points at 0, 1/PLACE_COUNT, ... of the outline, m, and inward normals (PLACE_COUNT, 4).

        They are in the body frame.
        """
        s, piece = self.reachable.locate(np.arange(PLACE_COUNT) / PLACE_COUNT)
        return np.column_stack([self.reachable.point(s, piece), -self.reachable.normal[piece]])

    @cached_property
    def occupancy(self) -> NDArray[np.uint8]:
        """Picture (PICTURE_PIXELS, PICTURE_PIXELS, 1) of the cells, OCCUPIED_VALUE where one is.

        Its rows go along -y, and its columns along x, of the body frame.
        """
        along = PICTURE_SIDE * ((np.arange(PICTURE_PIXELS) + 0.5) / PICTURE_PIXELS - 0.5)
        pixels = np.stack(np.meshgrid(along, -along), axis=-1).reshape(-1, 2) + self.obj.p_BC.mean(
            axis=0
        )
        half = self.obj.cell_size / 2
        inside = (np.abs(pixels[:, None] - self.obj.p_BC).max(axis=-1) <= half).any(axis=1)
        return (
            np.where(inside, OCCUPIED_VALUE, 0)
            .astype(np.uint8)
            .reshape(PICTURE_PIXELS, PICTURE_PIXELS, 1)
        )

    @cached_property
    def grasp_parts(self) -> tuple[GraspPart, ...]:
        """The parts of the object that the gripper can take."""
        return tuple(find_grasp_parts(self.obj))

    def make_push(self, action: Array, pose: Array) -> Push:
        """Makes the push of an action on an object that is seen at a pose (3,), m and rad.

        The action is (3,) place, direction and distance, each from -1 to 1, which stand for shares
        of the outline from 0 to 1 (which is 0 again), and for the least and the greatest of
        `FINGER.angle_range` and `FINGER.distance_range`. Numbers beyond are taken for the nearest
        of them.

        Raises:
            PlanningError: the action is not three finite numbers.
        """
        fraction, angle, distance = (
            np.clip(check_vector(PlanningError, "action", action, 3), -1.0, 1.0) + 1.0
        ) / 2.0
        s, _ = self.reachable.locate(fraction % 1.0)
        low, high = FINGER_OPTIONS.angle_range
        least, greatest = FINGER_OPTIONS.distance_range
        return Push.on_outline(
            self.obj,
            float(s),
            low + (high - low) * angle,
            least + (greatest - least) * distance,
            radius=FINGER_RADIUS,
            speed=FINGER_OPTIONS.pusher.speed,
            pose=pose,
            clearance=FINGER_OPTIONS.pusher.clearance,
        )

    def find_action(self, push: Push, pose: Array) -> NDArray[np.float32]:
        """Finds the action (3,) that comes nearest to a push of an object seen at a pose (3,).

        `make_push` of it gives that push again where it touches the outline as `Push.on_outline`
        would have it, with the finger's radius and clearance, and its direction and distance are
        among those that can be made.
        """
        # The piece of the outline that is nearest to the finger's surface.
        reach = self.reachable
        normal = reach.normal
        away = (FINGER_RADIUS + FINGER_OPTIONS.pusher.clearance) * normal
        start = transform_back(pose, push.start[None])[0] - away
        along = np.clip(((start - reach.origin) * reach.tangent).sum(axis=1), reach.low, reach.high)
        off = np.linalg.norm(reach.origin + along[:, None] * reach.tangent - start, axis=1)
        piece = int(off.argmin())

        # The push's direction from the inward normal there.
        heading = np.arctan2(push.velocity[1], push.velocity[0]) - pose[2]
        inwards = np.arctan2(-normal[piece, 1], -normal[piece, 0])
        angle = (heading - inwards + np.pi) % (2 * np.pi) - np.pi
        ranges = np.array([(0.0, 1.0), FINGER_OPTIONS.angle_range, FINGER_OPTIONS.distance_range])
        values = np.array([reach.calc_fraction(float(along[piece]), piece), angle, push.length])
        action = 2 * (values - ranges[:, 0]) / np.ptp(ranges, axis=1) - 1
        return np.clip(action, -1.0, 1.0).astype(np.float32)


def load_shapes(objects: Sequence[str | GridObject]) -> list[KnownShape]:
    """Makes the shapes of objects, or of shipped ones by their names.

    Raises:
        ObjectError: no shipped object has one of the names.
    """
    return [load_shape(one) if isinstance(one, str) else KnownShape(one) for one in objects]


@lru_cache(maxsize=32)
def load_shape(name: str) -> KnownShape:
    """Loads a shipped object by its name. Raises ObjectError where there is none."""
    return KnownShape(GridObject.from_yaml(find_shipped_object(name)))
