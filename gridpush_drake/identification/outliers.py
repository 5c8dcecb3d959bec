"""Poses and pushes that cannot be used: a tracker that jumped or flipped, a push that belongs to another object.

Two looks are taken (`docs/theory/identification.md`, section 5). Before the fit, no motion of the
pusher explains a jump between frames: of each push the longest chain of poses is kept in which each
can be reached from the one before. After it, each pose is compared with what all others say of it,
and each push with what the other pushes say.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics import GRAVITY
from gridpush_drake.dynamics.push import Push
from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.plausibility import SPEED_FACTOR, TRAVEL_FACTOR
from gridpush_drake.pushes.push_log import ObservedPush, PushLog, nearest_turn

Mask = NDArray[np.bool_]
IntArray = NDArray[np.int64]

JUMP_SLACK = 0.008
"""m that a pose may be off besides what the pusher can have moved it."""

FIRST_POSE_BONUS = 0.5
"""Poses that the first one counts for beyond itself: of two chains as long the one with it is
taken."""

MAX_JUMP_SHARE = 0.4
"""Of a log's poses; if more seem to jump, the log is what is wrong, and is left as it is."""

OUTLIER_ODDS = 0.02
"""Of a pose, or a push, to be wrong rather than right, beforehand."""

MAX_REFUSED_POSES = 0.5
"""Share of a push's poses; where more do not agree with the rest, it is the push that is in
doubt."""

MIN_PUSHES_EACH = 4
"""Pushes that it takes to refuse one as a whole."""

SUSPECT_ODDS = -9.0
"""Log odds to be another object's, to first order, from which a push is tried to be done
without."""

OUTLIER_GROWTH = 0.3
"""How far off another object's poses are expected to be, as a share of the pusher's travel."""


@dataclass(frozen=True)
class Outlier:
    """What was refused of a push.

    Attributes:
        push: its name.
        poses: the poses refused, 0 the first of the push.
        observed: how many poses the push has, the first included.
        whole: whether the whole push is refused, because it belongs to another object or too few
            poses were left.
    """

    push: str
    poses: tuple[int, ...]
    observed: int
    whole: bool

    @property
    def share(self) -> float:
        """Of the push's poses that are refused, 0 to 1."""
        return 1.0 if self.whole else len(self.poses) / self.observed

    def describe(self) -> str:
        """What was refused, in a sentence."""
        if self.whole and not self.poses:
            return f"push {self.push}: refused, as no motion of this object that the other pushes allow"
        where = f"{len(self.poses)} of {self.observed} poses jump or disagree with the rest"
        numbers = ", ".join(str(i + 1) for i in self.poses)
        return f"push {self.push}: {where} (number {numbers})" + (
            ", all of it refused" if self.whole else ", refused"
        )


@dataclass(frozen=True, eq=False)
class LeftOut:
    """What the other pushes say of one.

    Attributes:
        precision: (3K, 3K) Q, inverse covariance of its residuals as the others predict them, 1/m².
        pull: (3K,) Q e, with e the residuals off that prediction, 1/m.
    """

    precision: Array
    pull: Array

    @property
    def log_density(self) -> float:
        """Of its residuals by the others, but for a constant."""
        e = np.linalg.solve(self.precision, self.pull)
        return -0.5 * float(self.pull @ e) + 0.5 * float(np.linalg.slogdet(self.precision)[1])


@dataclass(frozen=True, eq=False)
class Screening:
    """A log as it is learned from, and what was refused of it.

    Attributes:
        log: the pushes with the poses that are kept.
        kept: of each push as observed, the poses that are kept, 0 the first; as many as there are
            where not listed.
        observed: of each push, how many poses it had.
        refused: names of the pushes refused as a whole.
    """

    log: PushLog
    kept: Mapping[str, IntArray] = field(default_factory=dict)
    observed: Mapping[str, int] = field(default_factory=dict)
    refused: frozenset[str] = frozenset()

    @classmethod
    def of_jumps(cls, obj: GridObject, log: PushLog) -> "Screening":
        """Refuses the poses that `find_jumps` finds; not in a push of which no two would be left."""
        masks = [mask if mask.sum() > 1 else np.ones_like(mask) for mask in find_jumps(obj, log)]
        chosen = select_poses(log, masks)
        kept = {seen.name: np.flatnonzero(mask) for seen, mask in zip(log, masks, strict=True)}
        return cls(chosen, kept, {seen.name: len(seen.t_observed) + 1 for seen in log})

    def keep(self, log: PushLog) -> "Screening":
        """The same with some of its pushes."""
        return replace(self, log=log)

    def refuse_poses(self, left_out: Sequence[LeftOut], size: float) -> "Screening":
        """Refuses the poses that do not agree with the rest; itself where all do.

        Args:
            left_out: what the others say of each push.
            size: of the object: its radius of gyration, m.
        """
        masks = [np.append(True, _judge_poses(seen, size)) for seen in left_out]
        masks = [
            mask if mask[1:].mean() > MAX_REFUSED_POSES else np.ones_like(mask) for mask in masks
        ]
        if all(mask.all() for mask in masks):
            return self
        kept = dict(self.kept)
        for seen, mask in zip(self.log, masks, strict=True):
            kept[seen.name] = kept[seen.name][mask]
        return replace(self, log=select_poses(self.log, masks), kept=kept)

    def refuse_push(self, index: int) -> "Screening":
        """Refuses a push of the log as a whole."""
        rest = self.log.subset([i for i in range(len(self.log)) if i != index])
        return replace(self, log=rest, refused=self.refused | {self.log[index].name})

    @property
    def may_refuse(self) -> int:
        """How many more pushes may be refused as a whole."""
        return len(self.kept) // MIN_PUSHES_EACH - len(self.refused)

    @property
    def outliers(self) -> tuple[Outlier, ...]:
        """What was refused, push by push."""
        found = []
        for name, kept in self.kept.items():
            poses = tuple(sorted(set(range(self.observed[name])) - set(kept.tolist())))
            if poses or name in self.refused:
                found.append(Outlier(name, poses, self.observed[name], name in self.refused))
        return tuple(found)


def find_jumps(obj: GridObject, log: PushLog) -> list[Mask]:
    """Finds the poses that the push cannot have led to from the ones before.

    Args:
        obj: the object.
        log: the pushes.

    Returns:
        A mask (K+1,) a push, the first pose included, of the poses to keep; all of them where so
        many seem to jump that the log itself must be wrong.
    """
    masks = [_find_chain(obj, seen) for seen in log]
    jumped = sum(int((~mask).sum()) for mask in masks)
    if jumped > MAX_JUMP_SHARE * sum(len(mask) for mask in masks):
        return [np.ones_like(mask) for mask in masks]
    return masks


def _find_chain(obj: GridObject, seen: ObservedPush) -> Mask:
    """The longest chain of poses, each within reach of the one before."""
    poses = np.vstack([seen.pose, seen.poses_observed])
    centroids = obj.cells_at(poses).mean(axis=1)
    way = seen.push.distance_at(np.append(0.0, seen.t_observed))
    speed = SPEED_FACTOR * seen.push.length / seen.push.duration
    slack = JUMP_SLACK + speed**2 / (2 * obj.prior.friction * GRAVITY)
    length, before = np.ones(len(poses)), np.full(len(poses), -1)
    length[0] += FIRST_POSE_BONUS
    for j in range(1, len(poses)):
        moved = np.linalg.norm(centroids[:j] - centroids[j], axis=1)
        turned = obj.radius_of_gyration * np.abs(wrap_angle(poses[:j, 2] - poses[j, 2]))
        reached = np.maximum(moved, turned) <= TRAVEL_FACTOR * (way[j] - way[:j]) + slack
        if reached.any():
            best = int(np.argmax(np.where(reached, length[:j], 0.0)))
            length[j], before[j] = length[best] + 1.0, best
    mask, k = np.zeros(len(poses), dtype=bool), int(np.argmax(length))
    while k >= 0:
        mask[k] = True
        k = int(before[k])
    return mask


def remove_outliers(log: PushLog, outliers: Sequence[Outlier]) -> PushLog:
    """The log without what was refused."""
    by_name = {outlier.push: outlier for outlier in outliers}
    masks = []
    for seen in log:
        mask = np.ones(len(seen.t_observed) + 1, dtype=bool)
        if (outlier := by_name.get(seen.name)) is not None:
            mask[list(outlier.poses)] = False
            mask &= not outlier.whole
        masks.append(mask)
    return select_poses(log, masks)


def select_poses(log: PushLog, masks: Sequence[Mask]) -> PushLog:
    """Takes the poses that masks keep, and the pushes of which two or more are left.

    A push whose first pose is out begins at the first that is kept.
    """
    kept = [_trim(seen, mask) for seen, mask in zip(log, masks, strict=True)]
    return replace(log, pushes=tuple(seen for seen in kept if seen is not None))


def _trim(seen: ObservedPush, mask: Mask) -> ObservedPush | None:
    kept = np.flatnonzero(mask)
    if len(kept) < 2:
        return None
    if mask.all():
        return seen
    later = kept[1:] - 1
    times, poses = seen.t_observed[later], seen.poses_observed[later]
    theta = seen.pose[2] if mask[0] else seen.poses_observed[kept[0] - 1, 2]
    for pose in poses:  # a flip may have turned all poses behind it by a whole turn
        theta = pose[2] = nearest_turn(pose[2], theta)
    if mask[0]:
        return replace(seen, t_observed=times, poses_observed=poses)
    begin = seen.t_observed[kept[0] - 1]
    t = np.append(begin, seen.push.t[seen.push.t > begin])
    push = Push.along(t, seen.push.tip_at(t), seen.push.radius)
    force_t, force = seen.force_t, seen.force
    if force_t is not None and force is not None:
        rest = force_t >= begin
        force_t, force = force_t[rest] - begin, force[rest]
    pose = seen.poses_observed[kept[0] - 1]
    return ObservedPush(seen.name, push, pose, times - begin, poses, force_t, force, seen.overhang)


def _judge_poses(seen: LeftOut, size: float) -> Mask:
    """Finds the later poses to keep: drops one by one, the worst first, those more likely to be anywhere."""
    kept = list(range(len(seen.pull) // 3))
    Q, g = seen.precision, seen.pull
    while len(kept) > 1:
        blocks = [slice(3 * i, 3 * i + 3) for i in range(len(kept))]
        odds = np.array([_calc_pose_odds(Q[block, block], g[block], size) for block in blocks])
        worst = int(np.argmax(odds))
        if odds[worst] <= 0:
            break
        out, rest = blocks[worst], np.delete(np.arange(len(g)), np.arange(3 * worst, 3 * worst + 3))
        slope = np.linalg.solve(Q[out, out], Q[out][:, rest]).T
        g = g[rest] - slope @ g[out]
        Q = Q[np.ix_(rest, rest)] - slope @ Q[out][:, rest]
        del kept[worst]
    mask = np.zeros(len(seen.pull) // 3, dtype=bool)
    mask[kept] = True
    return mask


def _calc_pose_odds(Q: Array, g: Array, size: float) -> float:
    """Log odds that a pose is anywhere, within about the object's size, rather than where the others put it."""
    e = np.linalg.solve(Q, g)
    here = -0.5 * float(g @ e) + 0.5 * np.linalg.slogdet(Q)[1]
    anywhere = -0.5 * float(e @ e) / size**2 - 3.0 * np.log(size)
    return float(anywhere - here + np.log(OUTLIER_ODDS))


def calc_outlier_odds(seen: LeftOut, way: Array) -> float:
    """Calculates the log odds that a push is another object's, whose residuals grow with the pusher's way together.

    Args:
        seen: what the other pushes say of it.
        way: (K,) m, how far the pusher has gone at each later pose.
    """
    D = np.kron(OUTLIER_GROWTH * way[:, None], np.eye(3))
    inner = np.eye(3) + D.T @ seen.precision @ D
    pull = D.T @ seen.pull
    gain = 0.5 * float(pull @ np.linalg.solve(inner, pull)) - 0.5 * np.linalg.slogdet(inner)[1]
    return float(gain + np.log(OUTLIER_ODDS))
