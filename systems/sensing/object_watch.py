"""`ObjectWatch`: whether the motion of an object, as it is seen, can be the finger's doing.

An object that is pushed slowly moves only while the finger touches it, and about as far as the
finger. One that is seen to move otherwise is seen wrongly, or somebody else moves it, with a hand
in the cell. For every two looks i and k at the object, the farthest that a point of it moved
between them is at most

    d_ik  <=  noise + MAX_LEVER_RATIO s(t_i - lag, t_k)

with s the way that the tip went sideways, near the object, from when the first look may have been
taken until the second one came. This module decides on nothing: `ArmGuard` stops the arm.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.frozen import Unchanging
from gridpush_drake.geometry.se2 import Array, transform, transform_shape
from gridpush_drake.units import MM_PER_M

MAX_LEVER_RATIO = 2.0
"""How much farther than the finger the farthest point of an object may go. In pushes of the
shipped objects it went 1.4 times as far, at most: an object turns about a point that lies beyond
its center of mass, seen from the finger."""

MAX_TOUCHING_GAP = 0.02
"""Greatest gap between the finger and the object's outline, or the object's top, at which the
finger may touch it, m. The pose may be as old as the camera is late."""

MEMORY_TIME = 0.5
"""How long looks are remembered, s, to be compared with the present one."""


@dataclass(frozen=True, eq=False)
class ObjectObservation(Unchanging):
    """One look at the object.

    Attributes:
        time: when the pose came, s.
        pose: (3,) X_WB of the object, m and rad.
        way: how far the tip had gone sideways near the object since the beginning, m.
        travel_before: the same, `lag` before the pose came, m: the pose may be as old as that.
    """

    time: float
    pose: Array
    way: float
    travel_before: float


@dataclass(frozen=True, eq=False)
class WatchState(Unchanging):
    """All that an `ObjectWatch` remembers; never changed, only replaced.

    Attributes:
        tip: (3,) where the finger's tip was last, p_WP, m; None before it was known.
        way: how far the tip has gone sideways near the object since the beginning, m.
        ways: (time in s, `way` then in m) of the last `lag`, the last one last.
        observations: the looks of the last `MEMORY_TIME`, the last one last.
        untouched: the first look since which the finger has not been near the object; None where it
            was since the last one.
    """

    tip: Array | None = None
    way: float = 0.0
    ways: tuple[tuple[float, float], ...] = ()
    observations: tuple[ObjectObservation, ...] = ()
    untouched: ObjectObservation | None = None


@dataclass(frozen=True, eq=False)
class ObjectWatch:
    """Judges whether an object moves as the finger moves it.

    Attributes:
        outline: outline of the object in its body frame B, m.
        height: height of the object's top above the table, m, or of the highest object's.
        tip_radius: radius of the finger's tip, a sphere, m; of a pusher of another shape, how far
            it reaches from its frame's origin.
        shape: of a pusher that is no disc; None of a disc.
        noise: greatest distance that a point of an object at rest may seem to move, m.
        lag: longest time from when a picture is taken until its pose comes, s.
        pushed_by_others: whether other objects lie on the table that the finger may push against
            it. A finger that is low enough then counts as near wherever it is.
    """

    outline: BaseGeometry
    height: float
    tip_radius: float
    noise: float = 0.01
    lag: float = 0.1
    pushed_by_others: bool = False
    shape: PusherShape | None = None
    corners: Array = field(init=False)
    """(k, 2) corners of the outline's convex hull in B, m: one of them moves the farthest."""

    def __post_init__(self) -> None:
        corners = shapely.get_coordinates(self.outline.convex_hull)
        object.__setattr__(self, "corners", corners)

    def is_near(self, pose: Array, p_WP: Array, yaw: float = 0.0) -> bool:
        """Returns whether the finger may touch the object, with its tip at p_WP (3,), m.

        The yaw is that of a shape's frame, rad.
        """
        if p_WP[2] - self.tip_radius > self.height + MAX_TOUCHING_GAP:
            return False
        if self.pushed_by_others:
            return True
        if self.shape is not None:
            covered = self.shape.at([*p_WP[:2], yaw])
            outline = transform_shape(pose, self.outline)
            return bool(outline.distance(covered) < MAX_TOUCHING_GAP)
        # The tip's place in B.
        offset = p_WP[:2] - pose[:2]
        cos = np.cos(pose[2])
        sin = np.sin(pose[2])
        p_BP = shapely.Point(cos * offset[0] + sin * offset[1], cos * offset[1] - sin * offset[0])
        return bool(self.outline.distance(p_BP) < MAX_TOUCHING_GAP + self.tip_radius)

    def calc_motion(self, before: Array, after: Array) -> float:
        """Calculates how far the farthest-moving point of the object goes between poses (3,), m."""
        moved = transform(after, self.corners) - transform(before, self.corners)
        return float(np.linalg.norm(moved, axis=1).max())

    def forget(self, now: WatchState) -> WatchState:
        """Forgets the looks at the object, which others may have moved, as they should."""
        return replace(now, observations=(), untouched=None)

    def watch(
        self, now: WatchState, time: float, pose: Array, p_WP: Array, yaw: float = 0.0
    ) -> tuple[WatchState, str]:
        """Takes in where tip and object are.

        Args:
            now: what is remembered.
            time: s.
            pose: (3,) X_WB of the object as it was seen last, m and rad; finite. It counts as
                another look where it has changed.
            p_WP: (3,) the tip's place, m; finite.
            yaw: angle of a shape's frame, rad.

        Returns:
            What is remembered from then on; and a sentence where the object cannot have moved like
            that, else "".
        """
        # The tip's way near the object, sideways.
        way = now.way
        if now.tip is not None and self.is_near(pose, p_WP, yaw):
            way += float(np.hypot(*(p_WP - now.tip)[:2]))
        ways = [item for item in now.ways if item[0] >= time - self.lag]
        now = replace(now, tip=np.array(p_WP), way=way, ways=(*ways, (time, way)))
        if now.observations and (pose == now.observations[-1].pose).all():
            return now, ""
        # Another look, compared with those before.
        observation = ObjectObservation(
            time=time, pose=np.array(pose), way=way, travel_before=now.ways[0][1]
        )
        earlier = [now.untouched] if now.untouched is not None else []
        earlier += [now.observations[0], now.observations[-1]] if now.observations else []
        fault = next(filter(None, (self._compare(one, observation) for one in earlier)), "")
        kept = tuple(one for one in now.observations if one.time >= time - MEMORY_TIME)
        touched = now.untouched is None or observation.way > now.untouched.travel_before
        untouched = observation if touched else now.untouched
        return replace(now, observations=(*kept, observation), untouched=untouched), fault

    def _compare(self, before: ObjectObservation, after: ObjectObservation) -> str:
        """Says that the object cannot have moved like that between two looks; "" if it can."""
        moved = self.calc_motion(before.pose, after.pose)
        way = after.way - before.travel_before
        if moved <= self.noise + MAX_LEVER_RATIO * way:
            return ""
        seen = f"the object was seen to move by {MM_PER_M * moved:.0f} mm"
        if way > 0.0:
            time = f"within {MM_PER_M * (after.time - before.time):.0f} ms"
            return f"{seen} {time}; the finger at it moved by {MM_PER_M * way:.0f} mm"
        return f"{seen} while nothing touched it; up to {MM_PER_M * self.noise:.0f} mm may be noise"
