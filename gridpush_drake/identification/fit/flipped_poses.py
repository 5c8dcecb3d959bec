"""Finds pushes in which a tracker took one end of a symmetric object for the other.

A rectangle that is turned by half a turn looks as before. A tracker that finds the outline anew
before each push may therefore report the same object now this way round and now the other. The
pushes then contradict each other. A fit of all of them puts the center of friction in the middle,
and takes it for well known.

Let c be the center of friction, seen from the outline's center, and let R_j be the turns that leave
the outline as it is. A push whose poses are off by the turn R_j is explained by a center R_j c as
well as the other pushes are by c:

    r_p + J_p R_j(p) c = 0     for all pushes p

with r_p the residuals of an even object and J_p their derivatives by the center. First, the c and
the turns j(p) are found that fit best to first order. Then both readings of the log, turned and as
it is, are fitted in full, and their evidence decides.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import affinity

from gridpush_drake.geometry.se2 import Array, compose, make_rotation
from gridpush_drake.identification.fit.map_fit import MapFit
from gridpush_drake.identification.statistics.noise import (
    NoiseModel,
    NoiseScale,
    calc_effective_count,
)
from gridpush_drake.identification.statistics.problem import SHIFT_COLUMNS, PushProblem
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

SYMMETRY_ORDERS = (6, 5, 4, 3, 2)
"""Numbers of positions in a full turn in which an outline may look the same, in the order in which
they are tried. That of a square is 4."""

MAX_AREA_DIFFERENCE = 0.02
"""Greatest fraction of its area by which an outline may differ from the turned one to count as the
same."""

MIN_PUSHES = 4
"""Least number of pushes with which turned poses are looked for."""

START_DIRECTIONS = 12
"""Directions of the center of friction from which the search begins."""

START_DISTANCES = (0.2, 0.5)
"""Distances of the center of friction from which it begins, radii of gyration."""

MAX_ROUNDS = 20
"""Most rounds of choosing the turns by the center, and the center by the turns."""

CENTER_STD = 0.6
"""Standard deviation per axis of the center of friction, before any push, radii of gyration."""

MIN_REPORT_EVIDENCE = 10.0
"""Least log odds, by the evidence of both fits, at which turned poses are reported. Beforehand, all
sets of turned pushes are taken for equally probable."""

MIN_PUSH_EVIDENCE = 3.0
"""Least log odds at which a single push is named as turned. A push through the center of friction
moves the object in the same way whether its poses are turned or not, and is not named."""

MIN_SHIFT = 1e-6
"""Standard deviation of the load's shift from push to push in the search to first order, m. It is
as good as zero."""

Turns = NDArray[np.int64]


@dataclass(frozen=True)
class FlippedPoses:
    """Pushes whose poses are a turn of a symmetric outline off those of the others.

    Attributes:
        names: names of the pushes that are surely turned; there may be more of them.
        pushes: how many pushes the log has.
        order: number of turns in a full one by which the outline looks the same.
        half: whether all that are turned are so by half a turn.
    """

    names: tuple[str, ...]
    pushes: int
    order: int
    half: bool


def find_symmetry(obj: GridObject) -> int:
    """The number of turns after which the outline looks the same, a full one among them.

    It is 1 if the outline has no symmetry.
    """
    outline = shapely.Polygon(obj.outline.exterior)
    center = outline.centroid
    for order in SYMMETRY_ORDERS:
        turned = affinity.rotate(outline, 360 / order, origin=center)
        if outline.symmetric_difference(turned).area <= MAX_AREA_DIFFERENCE * outline.area:
            return order
    return 1


def find_flipped_poses(
    problem: PushProblem,
    log: PushLog,
    kept: PushLog,
    z0: Array,
    noise: NoiseModel,
    fit: Callable[[PushProblem], MapFit],
) -> FlippedPoses | None:
    """Finds the pushes whose poses are a turn of a symmetric outline off; None where none are.

    Args:
        problem: of the log.
        log: the pushes, all of which touch the object.
        kept: those of them, with their poses, that contradict the others so little that they were
            learned from.
        z0: (n+1,) z of the even object.
        noise: what is held of the pushes' noise.
        fit: fits the pushes of a problem in full.
    """
    obj = problem.obj
    if len(log) < MIN_PUSHES:
        return None
    order = find_symmetry(obj)
    if order == 1:
        return None
    turns = _search_turns(problem, z0, noise, order)
    if not turns.any():
        return None
    turned = fit(problem.replace_log(turn_poses(obj, log, turns, order)))
    # pushes through the center hardly tell to first order which way round they are, but in full
    better = np.argmin(_calc_losses(problem, log, turned, order), axis=1)
    if not np.array_equal(better, turns):
        again = fit(problem.replace_log(turn_poses(obj, log, better, order)))
        if again.log_evidence > turned.log_evidence:
            turned, turns = again, better
    gain = turned.log_evidence - fit(problem).log_evidence - calc_occam(len(log), order)
    if gain < MIN_REPORT_EVIDENCE or not _explains_kept(problem, log, kept, turns, order, fit):
        return None
    losses = _calc_losses(problem, log, turned, order)
    usual = find_usual(turns, order)
    turns = (turns - usual) % order
    # by how much less each push is explained if its poses are taken as they are
    flipped = losses[:, usual] - losses.min(axis=1) > MIN_PUSH_EVIDENCE
    turns[~flipped] = 0
    names = [seen.name for seen, turn in zip(log, turns, strict=True) if turn]
    if not names:
        return None
    half = bool((2 * turns[turns > 0] == order).all())
    return FlippedPoses(names=tuple(names), pushes=len(log), order=order, half=half)


def _explains_kept(
    problem: PushProblem,
    log: PushLog,
    kept: PushLog,
    turns: Turns,
    order: int,
    fit: Callable[[PushProblem], MapFit],
) -> bool:
    """Says whether the pushes that were learned from show the turns without those left out.

    A few pushes of another object contradict the others, too, and turns may explain them. But once
    they are left out, the others agree without turns, and there is nothing to report. The same is
    true if the pushes that were left out are just the turned ones: the others then show the right
    center.
    """
    turn_of = {seen.name: turn for seen, turn in zip(log, turns, strict=True)}
    turns_kept = np.array([turn_of[seen.name] for seen in kept])
    if not turns_kept.any():
        return False
    turned = fit(problem.replace_log(turn_poses(problem.obj, kept, turns_kept, order)))
    gain = turned.log_evidence - fit(problem.replace_log(kept)).log_evidence
    return gain > calc_occam(len(kept), order)


def calc_occam(pushes: int, order: int) -> float:
    """Calculates the log of the number of ways in which pushes can be turned.

    All ways are equally probable beforehand. Turns must therefore explain the pushes better by this
    much. (Turning all pushes alike makes no difference, so that one of them is not counted.)
    """
    return (pushes - 1) * float(np.log(order))


def turn_poses(obj: GridObject, log: PushLog, turns: Turns, order: int) -> PushLog:
    """Turns the poses of each push about the outline's center, which stays where it is.

    Args:
        obj: the object.
        log: the pushes.
        turns: (P,) by how many of the outline's turns the poses of each push are turned.
        order: number of these turns in a full turn.

    Returns:
        The log with the turned poses.
    """
    center = shapely.Polygon(obj.outline.exterior).centroid
    p_BC = np.array([center.x, center.y])

    def turn(seen: ObservedPush, count: int) -> ObservedPush:
        if not count:
            return seen
        angle = 2 * np.pi * count / order
        # the outline's center keeps its place: X_WB' = X_WB X_BB', p_BC = p_BB' + R p_BC
        X_BB = np.append(p_BC - make_rotation(angle) @ p_BC, angle)
        poses = [compose(pose, X_BB) for pose in seen.poses_observed]
        return replace(seen, pose=compose(seen.pose, X_BB), poses_observed=np.array(poses))

    pushes = (turn(seen, int(count)) for seen, count in zip(log, turns, strict=True))
    return replace(log, pushes=tuple(pushes))


def _search_turns(problem: PushProblem, z0: Array, noise: NoiseModel, order: int) -> Turns:
    """Searches for the turns (P,) that explain the pushes best to first order.

    Returns:
        The number of turns of each push; all are 0 if turns explain the pushes hardly any better.
    """
    linear = problem.linearize(z0)
    # The center is what is looked for. The noise model's shift of the load from push to push could
    # explain it just as well, and is therefore left out.
    whitenings = replace(noise, load_shift=MIN_SHIFT).make_whitenings(
        linear.by_inputs, NoiseScale()
    )
    r = [W.apply(values) for W, values in zip(whitenings, linear.residuals, strict=True)]
    J = [
        W.apply(inputs[:, SHIFT_COLUMNS])
        for W, inputs in zip(whitenings, linear.by_inputs, strict=True)
    ]
    # the loss of push p at a center c is a_p + 2 b_p·c + c·H_p c
    a = np.array([one @ one for one in r])
    b = np.array([slope.T @ one for slope, one in zip(J, r, strict=True)])
    H = np.array([slope.T @ slope for slope in J])
    turns = [make_rotation(2 * np.pi * j / order) for j in range(order)]
    rho = problem.obj.radius_of_gyration
    prior = np.eye(2) / (CENTER_STD * rho) ** 2

    def calc_losses(c: Array) -> Array:
        """(P, order) of each push with each turn."""
        centers = np.array([R @ c for R in turns])
        quadratic = np.einsum("jx,pxy,jy->pj", centers, H, centers)
        return np.asarray(a[:, None] + 2 * b @ centers.T + quadratic)

    def find_center(chosen: Turns) -> Array:
        A = prior + sum(turns[j].T @ H[p] @ turns[j] for p, j in enumerate(chosen))
        pull = sum(turns[j].T @ b[p] for p, j in enumerate(chosen))
        return np.asarray(np.linalg.solve(A, -pull))

    def calc_loss(c: Array, chosen: Turns) -> float:
        return float(calc_losses(c)[np.arange(len(a)), chosen].sum() + c @ prior @ c)

    def improve(c: Array) -> tuple[float, Turns]:
        chosen = np.zeros(len(a), dtype=np.int64)
        for _ in range(MAX_ROUNDS):
            best = np.argmin(calc_losses(c), axis=1)
            c = find_center(best)
            if np.array_equal(best, chosen):
                break
            chosen = best
        return calc_loss(c, chosen), chosen

    angles = 2 * np.pi * np.arange(START_DIRECTIONS) / START_DIRECTIONS
    found = [
        improve(distance * rho * np.array([np.cos(angle), np.sin(angle)]))
        for distance in START_DISTANCES
        for angle in angles
    ]
    least, best = min(found, key=lambda one: one[0])
    none = np.zeros_like(best)
    # If the residuals that are left are larger than the noise model says, the noise is larger, and
    # a gain tells less by as much.
    scale = max(1.0, least / sum(calc_effective_count(len(one)) for one in r))
    gain = 0.5 * (calc_loss(find_center(none), none) - least) / scale
    if gain < calc_occam(len(best), order):
        return none
    return np.asarray((best - find_usual(best, order)) % order, dtype=np.int64)


def _calc_losses(problem: PushProblem, log: PushLog, fit: MapFit, order: int) -> Array:
    """Calculates the negative log likelihood (P, order) of each push with each turn by a fit.

    It is known up to a constant.
    """
    losses = []
    for turn in range(order):
        turned = turn_poses(problem.obj, log, np.full(len(log), turn), order)
        residuals = problem.replace_log(turned).residuals(fit.z)
        whitened = zip(fit.linearized.whitenings, residuals, strict=True)
        losses.append([fit.linearized.noise.calc_loss(W.apply(r)) for W, r in whitened])
    return np.array(losses).T


def find_usual(turns: Turns, order: int) -> int:
    """Finds the turn that most pushes have, which is then taken for none.

    If all pushes are turned by the same turn more, they fit as well: only differences are known.
    """
    return int(np.argmax(np.bincount(turns, minlength=order)))
