"""Poses and pushes that cannot be used: a tracker that jumped, a push of another object.

They are looked for twice (`docs/theory/identification.md`, section 5). Before the fit, poses are
refused that the pusher cannot have caused: of each push the longest chain of poses is kept in which
each can be reached from the one before. After the fit, each pose is compared with what all other
poses predict, and each push with what the other pushes predict. `robust_fit` decides what is
refused in the end, and makes the fits in between.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics import GRAVITY
from gridpush_drake.geometry.se2 import Array, IntArray, wrap_angle
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.observed_push import ObservedPush, nearest_turn
from gridpush_drake.pushes.plausibility import SPEED_FACTOR, TRAVEL_FACTOR
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.units import MM_PER_M

Mask = NDArray[np.bool_]

JUMP_SLACK = 0.008
"""Distance that an object may seem to have moved without being pushed, m. A pose farther than this
from where the pusher can have moved the object has jumped."""

FIRST_POSE_BONUS = 0.5
"""Number of poses by which a chain counts as longer if it begins with the push's first pose. Of two
chains of the same length, the one that begins there is kept."""

MAX_JUMP_FRACTION = 0.4
"""Largest fraction of a log's poses that may jump. If more seem to, the log itself is wrong, and
all its poses are kept."""

OUTLIER_PRIOR_RATIO = 0.02
"""Prior odds that a pose, or a push, is wrong rather than right."""

MAX_REFUSED_POSES = 0.5
"""Largest fraction of a push's poses that are refused one by one. If more disagree with the rest,
it is the push as a whole that is in doubt, and its poses are kept."""

KEPT_EACH = 2
"""For each push that is refused as a whole, more than so many must be kept: fewer than a third of
the pushes are refused."""

SUSPECT_EVIDENCE = -9.0
"""Log odds, to first order, that a push is another object's. If they are higher, the other pushes
are fitted again without it."""

ODD_FACTOR = 3.0
"""If no model comes nearer to a push than this many times the usual distance, the push is odd: it
tells little of which model is the better one, and counts the less the farther off it is."""

OUTLIER_GROWTH = 0.3
"""Standard deviation of how far off another object's poses are, as a fraction of the pusher's
travel."""


@dataclass(frozen=True)
class Disagreement:
    """How far a push that was refused ends from where the other pushes put its end.

    Attributes:
        distance: root mean square over the object's cells, m.
        deviations: the same in standard deviations of the prediction.
        allowed: largest distance of a push of this kind that would have been believed, m.
    """

    distance: float
    deviations: float
    allowed: float


@dataclass(frozen=True)
class Outlier:
    """A push of which poses, or all, were refused.

    Attributes:
        push: its name.
        poses: numbers of the poses that were refused; 0 is the first pose of the push.
        observed: how many poses the push has, the first included.
        whole: whether the whole push is refused, because it belongs to another object or too few
            poses were left.
        disagreement: how far a push that belongs to another object is off; None where that is not
            why it was refused, or in model files in which it was not written yet.
    """

    push: str
    poses: tuple[int, ...]
    observed: int
    whole: bool
    disagreement: Disagreement | None = None

    @property
    def fraction(self) -> float:
        """Fraction of the push's poses that are refused, from 0 to 1."""
        return 1.0 if self.whole else len(self.poses) / self.observed

    def describe(self) -> str:
        """Says in a sentence what was refused."""
        off = self._describe_distance()
        if self.whole and not self.poses:
            return (
                f"push {self.push}: refused, "
                f"as no motion of this object that the other pushes allow{off}"
            )
        where = f"{len(self.poses)} of {self.observed} poses jump or disagree with the rest"
        numbers = ", ".join(str(i + 1) for i in self.poses)
        what = "all of it refused" if self.whole else "refused"
        return f"push {self.push}: {where} (number {numbers}), {what}{off}"

    def _describe_distance(self) -> str:
        """Says how far off the push is, and how it is learned from all the same."""
        if self.disagreement is None:
            return ""
        far = self.disagreement
        return (
            f": it ends {far.distance * MM_PER_M:.1f} mm ({far.deviations:.1f} standard "
            f"deviations) from where they put it, and {far.allowed * MM_PER_M:.1f} mm would have "
            f"been believed; --keep {self.push} (keep= in Python) learns from it all the same"
        )


@dataclass(frozen=True, eq=False)
class LeftOut:
    """How far a push is from what all other pushes predict of it.

    Attributes:
        precision: (3K, 3K) Q, inverse covariance of the push's residuals by the prediction, 1/m².
        pull: (3K,) Q e, with e the difference of the residuals from the prediction, 1/m.
    """

    precision: Array
    pull: Array

    @property
    def log_density(self) -> float:
        """Log density of the push's residuals by the prediction, up to a constant."""
        # log N(e; 0, Q^-1) = -1/2 e^T Q e + 1/2 log det Q
        e = np.linalg.solve(self.precision, self.pull)
        return -0.5 * float(self.pull @ e) + 0.5 * float(np.linalg.slogdet(self.precision)[1])


@dataclass(frozen=True, eq=False)
class ScreenedLog:
    """A log as it is learned from, and what was refused of it.

    Attributes:
        log: the pushes with the poses that are kept.
        kept: numbers of the poses that are kept, by the push's name; 0 is the first pose. If a push
            is not listed, all its poses are kept.
        observed: how many poses each push had, the first included, by the push's name.
        refused: how far off the pushes are that are refused as a whole, by name.
        trusted: names of the pushes of which nothing is refused because the others disagree.
    """

    log: PushLog
    kept: Mapping[str, IntArray] = field(default_factory=dict)
    observed: Mapping[str, int] = field(default_factory=dict)
    refused: Mapping[str, Disagreement] = field(default_factory=dict)
    trusted: frozenset[str] = frozenset()

    @classmethod
    def of_jumps(
        cls, obj: GridObject, log: PushLog, trusted: Collection[str] = ()
    ) -> "ScreenedLog":
        """Refuses the poses that `find_jumps` finds, if two or more of the push are left.

        Args:
            obj: the object.
            log: the pushes.
            trusted: names of the pushes of which nothing else will be refused.
        """
        masks = [mask if mask.sum() > 1 else np.ones_like(mask) for mask in find_jumps(obj, log)]
        return cls(
            log=select_poses(log, masks),
            kept={seen.name: np.flatnonzero(mask) for seen, mask in zip(log, masks, strict=True)},
            observed={seen.name: len(seen.t_observed) + 1 for seen in log},
            trusted=frozenset(trusted),
        )

    def keep(self, log: PushLog) -> "ScreenedLog":
        """Keeps some of the pushes; the others count neither as learned from nor as refused."""
        return replace(self, log=log)

    def refuse_poses(self, left_out: Sequence[LeftOut], size: float) -> "ScreenedLog":
        """Refuses the poses that do not agree with the rest.

        Args:
            left_out: for each push, how far it is from what the others predict.
            size: the object's radius of gyration, m.

        Returns:
            The log without these poses; this object itself if all poses agree.
        """
        masks = []
        for seen, one in zip(self.log, left_out, strict=True):
            # The first pose is where the simulation begins: it cannot disagree.
            mask = np.append(True, _judge_poses(one, size))
            # If most poses disagree, the push as a whole is in doubt, which is not decided here.
            few = mask[1:].mean() > MAX_REFUSED_POSES
            masks.append(mask if few and seen.name not in self.trusted else np.ones_like(mask))
        if all(mask.all() for mask in masks):
            return self

        # Poses are named by their place in the log as it was read.
        kept = dict(self.kept)
        for seen, mask in zip(self.log, masks, strict=True):
            kept[seen.name] = kept[seen.name][mask]
        return replace(self, log=select_poses(self.log, masks), kept=kept)

    def refuse_pushes(self, disagreements: Mapping[int, Disagreement]) -> "ScreenedLog":
        """Refuses pushes of the log as a whole.

        Args:
            disagreements: how far off they are, by their place in the log.
        """
        rest = self.log.subset([i for i in range(len(self.log)) if i not in disagreements])
        names = {self.log[i].name: one for i, one in disagreements.items()}
        return replace(self, log=rest, refused={**self.refused, **names})

    @property
    def may_refuse(self) -> int:
        """How many more pushes may be refused as a whole."""
        most = (len(self.kept) - 1) // (KEPT_EACH + 1)
        return most - len(self.refused)

    @property
    def outliers(self) -> tuple[Outlier, ...]:
        """All that was refused, push by push."""
        found = []
        for name, kept in self.kept.items():
            poses = tuple(sorted(set(range(self.observed[name])) - set(kept.tolist())))
            if poses or name in self.refused:
                found.append(
                    Outlier(
                        push=name,
                        poses=poses,
                        observed=self.observed[name],
                        whole=name in self.refused,
                        disagreement=self.refused.get(name),
                    )
                )
        return tuple(found)


def weigh_pushes(errors: Sequence[Array], noise_std: float) -> Array:
    """Weighs pushes by how odd they are, where models are compared by them.

    What no model predicts, such as a push in which a hand helped, says next to nothing of which one
    is right; but it is farther off than all others together, and would decide a mean.

    Args:
        errors: (P,) errors of each push by each of the models, m.
        noise_std: distance that is usual in any case, m.

    Returns:
        (P,) weights: 1 up to ODD_FACTOR times the median of what the nearest model leaves, and from
        there on less by the square of the distance.
    """
    nearest = np.min(errors, axis=0)
    usual = ODD_FACTOR * max(float(np.median(nearest)), noise_std)
    return np.asarray(np.square(usual / np.maximum(nearest, usual)))


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
    if jumped > MAX_JUMP_FRACTION * sum(len(mask) for mask in masks):
        return [np.ones_like(mask) for mask in masks]
    return masks


def leave_out_jumps(obj: GridObject, seen: ObservedPush) -> ObservedPush:
    """Leaves out the poses of a single push that it cannot have led to from the ones before.

    Args:
        obj: the object.
        seen: the push.

    Returns:
        The push with the longest chain of poses that it can have led to; itself where that is a
        single pose. Where the object was moved by something else before most of its poses, that is
        the push as it went on behind that.
    """
    return _trim(seen, _find_chain(obj, seen)) or seen


def _find_chain(obj: GridObject, seen: ObservedPush) -> Mask:
    """Finds the longest chain of a push's poses, each within reach of the one before.

    Returns:
        A mask (K+1,) of the poses in the chain, the first pose of the push included.
    """
    poses = np.vstack([seen.pose, seen.poses_observed])
    centroids = obj.cells_at(poses).mean(axis=1)
    way = seen.push.distance_at(np.append(0.0, seen.t_observed))

    # An object that was pushed fast slides on by itself, v² / (2 mu g), after the pusher stops.
    speed = SPEED_FACTOR * seen.push.length / seen.push.duration
    slack = JUMP_SLACK + speed**2 / (2 * obj.prior.friction * GRAVITY)

    # Dynamic programming: the longest chain that ends at pose j goes on from the longest one that
    # ends at any earlier pose from which j can be reached.
    length = np.ones(len(poses))
    length[0] += FIRST_POSE_BONUS
    before = np.full(len(poses), -1)
    for j in range(1, len(poses)):
        moved = np.linalg.norm(centroids[:j] - centroids[j], axis=1)
        turn = np.abs(wrap_angle(poses[:j, 2] - poses[j, 2]))
        turned = obj.radius_of_gyration * turn
        reach = TRAVEL_FACTOR * (way[j] - way[:j]) + slack
        reached = np.maximum(moved, turned) <= reach
        if reached.any():
            best = int(np.argmax(np.where(reached, length[:j], 0.0)))
            length[j] = length[best] + 1.0
            before[j] = best

    # Back from the end of the longest chain of all.
    mask = np.zeros(len(poses), dtype=bool)
    k = int(np.argmax(length))
    while k >= 0:
        mask[k] = True
        k = int(before[k])
    return mask


def remove_outliers(log: PushLog, outliers: Sequence[Outlier]) -> PushLog:
    """Leaves out of a log what was refused of it: single poses, and whole pushes."""
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
    """Takes the poses (K+1,) of a push that a mask keeps; None where fewer than two are left."""
    kept = np.flatnonzero(mask)
    if len(kept) < 2:
        return None
    if mask.all():
        return seen

    # A flip of the tracker may have turned all poses behind it by a whole turn.
    later = kept[1:] - 1
    times = seen.t_observed[later]
    poses = seen.poses_observed[later]
    theta = seen.pose[2] if mask[0] else seen.poses_observed[kept[0] - 1, 2]
    for pose in poses:
        theta = nearest_turn(pose[2], theta)
        pose[2] = theta
    if mask[0]:
        return replace(seen, t_observed=times, poses_observed=poses)

    # The simulation begins at the first pose. If that is refused, the push begins later, and its
    # clock with it.
    begin = seen.t_observed[kept[0] - 1]
    t = np.append(begin, seen.push.t[seen.push.t > begin])
    force_t = seen.force_t
    force = seen.force
    lift_force = seen.lift_force
    if force_t is not None and force is not None:
        rest = force_t >= begin
        force_t = force_t[rest] - begin
        force = force[rest]
        lift_force = None if lift_force is None else lift_force[rest]
    return ObservedPush(
        name=seen.name,
        push=seen.push.cut(t),
        pose=seen.poses_observed[kept[0] - 1],
        t_observed=times - begin,
        poses_observed=poses,
        force_t=force_t,
        force=force,
        overhang=seen.overhang,
        lift_force=lift_force,
    )


def _judge_poses(seen: LeftOut, size: float) -> Mask:
    """Finds the later poses of a push to keep.

    Those more likely to be anywhere than where the others put them are dropped one by one, the
    worst first: next to a pose that is far off, good ones look bad.

    Args:
        seen: what the other pushes say of the push.
        size: the object's radius of gyration, m.

    Returns:
        A mask (K,).
    """
    kept = list(range(len(seen.pull) // 3))
    Q = seen.precision
    g = seen.pull
    while len(kept) > 1:
        blocks = [slice(3 * i, 3 * i + 3) for i in range(len(kept))]
        evidence = np.array(
            [_calc_pose_evidence(Q[block, block], g[block], size) for block in blocks]
        )
        worst = int(np.argmax(evidence))
        if evidence[worst] <= 0:
            break

        # Without that pose: the Schur complement is the precision of the others by themselves.
        out = blocks[worst]
        rest = np.delete(np.arange(len(g)), np.arange(3 * worst, 3 * worst + 3))
        beside = Q[out][:, rest]
        slope = np.linalg.solve(Q[out, out], beside).T
        g = g[rest] - slope @ g[out]
        Q = Q[np.ix_(rest, rest)] - slope @ beside
        del kept[worst]

    mask = np.zeros(len(seen.pull) // 3, dtype=bool)
    mask[kept] = True
    return mask


def _calc_pose_evidence(Q: Array, g: Array, size: float) -> float:
    """Log odds that a pose is anywhere near the object, rather than where the others put it.

    Args:
        Q: (3, 3) precision of the pose, given the others.
        g: (3,) Q e, e the distance of the pose from where the others put it.
        size: the object's radius of gyration, m; a wrong pose is about so far off.
    """
    # Both normals without their common factor: N(e; 0, Q^-1) against N(e; 0, size² I).
    e = np.linalg.solve(Q, g)
    here = -0.5 * float(g @ e) + 0.5 * np.linalg.slogdet(Q)[1]
    anywhere = -0.5 * float(e @ e) / size**2 - 3.0 * np.log(size)
    return float(anywhere - here + np.log(OUTLIER_PRIOR_RATIO))


@dataclass(frozen=True)
class OutlierEvidence:
    """Log odds that a push is another object's, of residuals of any size: a s² - b of s e.

    Attributes:
        slope: a, how much the residuals e of the push speak for it.
        offset: b, how much speaks against it before any residual is seen.
    """

    slope: float
    offset: float

    @property
    def log_ratio(self) -> float:
        """The log odds of the residuals as they are."""
        return self.slope - self.offset

    def explain(self, seen: LeftOut) -> Disagreement:
        """Says how far off the push is.

        Args:
            seen: what the other pushes say of it.
        """
        covariance = np.linalg.inv(seen.precision)
        end = (covariance @ seen.pull)[-3:]
        # the size s of the residuals at which the odds are even
        believed = float(np.sqrt(max(self.offset, 0.0) / self.slope))
        distance = float(np.linalg.norm(end))
        return Disagreement(
            distance=distance,
            deviations=float(np.sqrt(end @ np.linalg.solve(covariance[-3:, -3:], end) / len(end))),
            allowed=believed * distance,
        )


def calc_outlier_evidence(seen: LeftOut, way: Array) -> OutlierEvidence:
    """Calculates the log odds that a push is another object's.

    The residuals of another object's push grow with the way of the pusher, all in the same
    direction.

    Args:
        seen: what the other pushes say of it.
        way: (K,) m, how far the pusher has gone at each later pose.
    """
    # One vector d ~ N(0, I) of three numbers for the whole push, which adds D d to its residuals.
    # Integrated over d, the evidence grows by a - log det(inner) / 2.
    D = np.kron(OUTLIER_GROWTH * way[:, None], np.eye(3))
    inner = np.eye(3) + D.T @ seen.precision @ D
    pull = D.T @ seen.pull
    return OutlierEvidence(
        slope=0.5 * float(pull @ np.linalg.solve(inner, pull)),
        offset=float(0.5 * np.linalg.slogdet(inner)[1] - np.log(OUTLIER_PRIOR_RATIO)),
    )
