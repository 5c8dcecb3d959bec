"""Mass, center of mass and mean friction in absolute numbers, with what is known of each.

Slow pushes show how friction is spread over an object, and none of its absolute numbers. Three
things that a robot feels anyway do. With m the mass, c the center of mass, mu the mean friction
coefficient, and n the outward normal of a table's edge through the point E:

    force of pushes   K = mu m g                             (`force_scale`)
    press at an edge  F = m g b / a                          it begins to tilt about the edge
                      b = n·(E - c_W),  a = n·(P - E)        P is where the tip presses
    lift              W = m g,  torque = m g (-l_y, l_x)     l = c_W - G, G is between the pads

with c_W = p + R(theta) c for an object that lies at the pose (p, theta). No friction enters the
press. One press gives the product of mass and lever arm, two at other overhangs or over another
edge give both. The unknowns are u = (log m, c, log mu), the error of every pose and, of each press,
how far the edge is truly from where it is said to be: e along n makes b longer by e and a shorter
by e. All have normal priors, and least squares and Laplace's
approximation give estimate and covariance (`docs/theory/identification.md`, section 11).

About which line an object tilted in a press is not known for sure, and is judged in
`tilt_tests`: about the edge, as above; about a line of supports D inside the edge, on which an
object whose bottom is not flat rocks first,

    F = m g (b - D) / (a + D)          log D is normal, and one for all presses of a rest

or neither, and then the press says nothing.

How the estimate changes a learned model is not here but in `weighed_model`.
"""

from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import chdtrc

from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.errors import IdentificationError
from gridpush_drake.geometry.se2 import Array, make_rotation, turn_left
from gridpush_drake.identification.absolute.force_scale import ForceScale
from gridpush_drake.identification.statistics.prior_fit import fit_with_prior
from gridpush_drake.objects.object_file import UNKNOWN_FRICTION
from gridpush_drake.pushes.weighings import (
    ANGLE_STD,
    EDGE_STD,
    POSITION_STD,
    LiftTest,
    MassTestLog,
    TiltTest,
)

INTERVAL_SIGMAS = 1.96
"""Number of standard deviations from the estimate to the ends of an interval: 95 % are within."""

LOG_MASS = 0
"""Index of log m among the unknowns."""

CENTER_INDICES = slice(1, 3)
"""Indices of the center of mass among the unknowns."""

LOG_FRICTION = 3
"""Index of log mu among the unknowns."""

WANTED_UNKNOWNS = 4
"""Number of unknowns that are wanted; those after them are errors of poses and edges."""

START_SIGMAS = (-1.5, 0.0, 1.5)
"""Standard deviations of the prior from its mean at which the mass is begun with. From far off the
least squares might end in a side valley."""

FIT_TOLERANCES = {"xtol": 1e-8, "ftol": 1e-9, "gtol": 1e-8}
"""At which changes of unknowns and sum of squares, and at which slope, the least squares end."""

MIN_FIT_PROBABILITY = 5e-3
"""Probability of a sum of squares as large as the one that is left, below which weighings, forces
and pushes are said to contradict each other. Of estimates whose errors are as they are supposed to
be, one in 200 is doubted."""

SHIFT_UNCERTAINTY = 0.4
"""Standard deviation of how far a tilt moves the center of mass outwards, as a fraction of it: the
height of the center is hardly known."""

LINE_DISTANCE = 0.03
"""Median of the distance D of a support line from the edge beforehand, m."""

LINE_SPREAD = 1.0
"""Standard deviation of log D beforehand."""


class TiltingLine(StrEnum):
    """About which line an object tilted in a press."""

    EDGE = "edge"
    SUPPORTS = "supports"
    """A line of two supports inside the edge: the object rocked."""
    NONE = "none"
    """None of these: the press is left out."""


@dataclass(frozen=True)
class AbsolutePrior:
    """What is held of mass and friction before anything is measured: next to nothing.

    Both logarithms are normal, with mean and standard deviation of the even distribution between
    the bounds. Beyond the bounds values are not impossible, only less and less probable.

    Attributes:
        mass: least and greatest mass that is likely, kg.
        friction: least and greatest mean friction coefficient that is likely.
    """

    mass: tuple[float, float] = (0.1, 3.0)
    friction: tuple[float, float] = UNKNOWN_FRICTION

    def __post_init__(self) -> None:
        for name, (low, high) in (("mass", self.mass), ("friction", self.friction)):
            if not 0 < low < high < np.inf:
                raise IdentificationError(
                    f"{name} is {(low, high)!r}; expected 0 < least < greatest"
                )

    @property
    def log_mass(self) -> tuple[float, float]:
        """Mean and standard deviation of log m."""
        return _match(self.mass)

    @property
    def log_friction(self) -> tuple[float, float]:
        """Mean and standard deviation of log mu."""
        return _match(self.friction)


def _match(bounds: tuple[float, float]) -> tuple[float, float]:
    """Mean and standard deviation of a logarithm that is evenly distributed between bounds."""
    low, high = np.log(bounds)
    return float(low + high) / 2, float(high - low) / np.sqrt(12)


@dataclass(frozen=True)
class PoseNoise:
    """How far off places and poses are that weighings rest on, as standard deviations.

    Attributes:
        position: of an object's seen position, per axis, m.
        angle: of its seen heading, rad.
        edge: of where the edge is along its normal, m, in each press. The fingertip is then as
            much nearer to it as the center of mass is farther from it.
    """

    position: float = POSITION_STD
    angle: float = ANGLE_STD
    edge: float = EDGE_STD

    def __post_init__(self) -> None:
        for name in ("position", "angle", "edge"):
            value = getattr(self, name)
            if not 0 < value < np.inf:
                raise IdentificationError(f"{name} is {value!r}; expected a positive number")


@dataclass(frozen=True)
class TiltTestCheck:
    """How a press at the edge was judged by what all other presses and the pushes say.

    Attributes:
        place: (x, y) where the tip pressed, body frame, m.
        arm: how far beyond the edge that was, m.
        force: that was measured, N.
        expected: force at which the object tilts about the edge by all that the others say, N.
        residual: measured less expected force, in standard deviations of their difference.
        line: about which line it tilted.
        probability: that it was this line.
        support_distance: how far the support line is inside the edge about which it rocked, m; None
            where no rocking is known.
    """

    place: tuple[float, float]
    arm: float
    force: float
    expected: float
    residual: float
    line: TiltingLine = TiltingLine.EDGE
    probability: float = 1.0
    support_distance: float | None = None


@dataclass(frozen=True, eq=False)
class AbsoluteEstimate:
    """Mass, center of mass and mean friction, and how well they are known.

    Attributes:
        mean: (4,) log m, the center of mass c in the body frame, m, and log mu; m in kg.
        covariance: (4, 4).
        presses: number of presses at an edge that it rests on.
        lifts: number of lifts.
        pushes: number of pushes whose forces were measured.
        agreement: probability of observations that agree as badly as these do, or worse; of those
            that were not left out.
        tests: how each press was judged, in their order.
        center_outlier_probability: that the pushes are wrong about the center of mass, as where
            feet of very different friction bear the object.
        gyration: radius of gyration about the vertical axis through c, m; 0 where it is not known.
        gyration_std: its standard deviation, m.
    """

    mean: Array
    covariance: Array
    presses: int = 0
    lifts: int = 0
    pushes: int = 0
    agreement: float = 1.0
    gyration: float = 0.0
    gyration_std: float = 0.0
    tests: "tuple[TiltTestCheck, ...]" = ()
    center_outlier_probability: float = 0.0

    @property
    def total_mass(self) -> float:
        """The mass m, kg."""
        return float(np.exp(self.mean[LOG_MASS]))

    @property
    def mass_interval(self) -> tuple[float, float]:
        """Bounds between which the mass is with a probability of 95 %, kg."""
        return self._calc_interval(LOG_MASS)

    @property
    def friction(self) -> float:
        """The mean friction coefficient mu = sum mu_i m_i / sum m_i."""
        return float(np.exp(self.mean[LOG_FRICTION]))

    @property
    def friction_interval(self) -> tuple[float, float]:
        """Bounds between which the mean friction is with a probability of 95 %."""
        return self._calc_interval(LOG_FRICTION)

    @property
    def center_of_mass(self) -> Array:
        """(2,) the center of mass p_BBcm, body frame, m."""
        return self.mean[CENTER_INDICES]

    @property
    def center_covariance(self) -> Array:
        """(2, 2) covariance of the center of mass, m²."""
        return self.covariance[CENTER_INDICES, CENTER_INDICES]

    @property
    def center_std(self) -> Array:
        """(2,) standard deviations of the center of mass along x and y of the body frame, m."""
        return np.sqrt(np.diag(self.center_covariance))

    @property
    def inertia(self) -> float:
        """Moment of inertia about the vertical axis through the center of mass, kg m²."""
        return self.total_mass * self.gyration**2

    @property
    def inertia_interval(self) -> tuple[float, float]:
        """Bounds between which the moment of inertia is with a probability of 95 %, kg m²."""
        relative = 2 * self.gyration_std / self.gyration if self.gyration > 0 else 0.0
        std = float(np.hypot(np.sqrt(self.covariance[LOG_MASS, LOG_MASS]), relative))
        factor = float(np.exp(INTERVAL_SIGMAS * std))
        return self.inertia / factor, self.inertia * factor

    @property
    def contradictory(self) -> bool:
        """Whether the observations contradict each other: nothing is planned with such numbers.

        That is if they agree worse than `MIN_FIT_PROBABILITY`, or if more presses were left out
        than counted.
        """
        left_out = sum(one.line == TiltingLine.NONE for one in self.tests)
        return self.agreement < MIN_FIT_PROBABILITY or 2 * left_out > len(self.tests)

    def summarize(self) -> dict[str, Any]:
        """Returns all numbers by name, in SI units; friction is None without measured forces."""
        rubs = self.pushes > 0
        return {
            "total_mass": self.total_mass,
            "total_mass_interval": self.mass_interval,
            "center_of_mass": self.center_of_mass,
            "center_of_mass_covariance": self.center_covariance,
            "friction": self.friction if rubs else None,
            "friction_interval": self.friction_interval if rubs else None,
            "inertia": self.inertia,
            "inertia_interval": self.inertia_interval,
            "presses": self.presses,
            "lifts": self.lifts,
            "pushes": self.pushes,
            "agreement": self.agreement,
            "contradictory": self.contradictory,
            "center_outlier_probability": self.center_outlier_probability,
            "tests": [asdict(one) for one in self.tests],
        }

    def _calc_interval(self, index: int) -> tuple[float, float]:
        """Bounds of an unknown whose logarithm is normal, of a probability of 95 %."""
        reach = INTERVAL_SIGMAS * float(np.sqrt(self.covariance[index, index]))
        low, high = np.exp(self.mean[index] + np.array([-reach, reach])).tolist()
        return low, high


@dataclass(frozen=True, eq=False)
class MassProblem:
    """The least-squares problem: unknowns, their priors, and the whitened residuals.

    Attributes:
        log: the weighings.
        center: (2,) where the center of mass is expected, body frame, m.
        center_covariance: (2, 2) of that, m².
        force: what measured forces say; None where there are none.
        prior: what is held of mass and friction beforehand.
        noise: of poses and edges.
        gravity: m/s².
        lines: about which line the object tilted in each press; about the edge in all where empty.
        outline_center: (2,) where the center of mass is expected if the pushes are wrong about it,
            m, and (2, 2) its covariance, m²; None where they cannot be.
        is_center_outlier: whether they are supposed to be.
    """

    log: MassTestLog
    center: Array
    center_covariance: Array
    force: ForceScale | None = None
    prior: AbsolutePrior = field(default_factory=AbsolutePrior)
    noise: PoseNoise = field(default_factory=PoseNoise)
    gravity: float = GRAVITY
    lines: tuple[TiltingLine, ...] = ()
    outline_center: tuple[Array, Array] | None = None
    is_center_outlier: bool = False

    def suppose_center_outlier(self) -> "MassProblem | None":
        """The problem if the pushes are wrong about the center of mass; None if they cannot be."""
        if self.outline_center is None:
            return None
        center, covariance = self.outline_center
        return replace(self, center=center, center_covariance=covariance, is_center_outlier=True)

    def suppose(self, lines: tuple[TiltingLine, ...]) -> "MassProblem":
        """The problem with other tilting lines."""
        return replace(self, lines=lines)

    @cached_property
    def tilting_lines(self) -> tuple[TiltingLine, ...]:
        """The tilting line of each press."""
        return self.lines or (TiltingLine.EDGE,) * len(self.log.presses)

    @cached_property
    def support_rests(self) -> list[tuple[float, ...]]:
        """The different rests at which the object rocked on supports; each has one support line."""
        keys = [
            _get_support_rest(press)
            for press, line in zip(self.log.presses, self.tilting_lines, strict=True)
            if line == TiltingLine.SUPPORTS
        ]
        return list(dict.fromkeys(keys))

    def find_support_rest(self, press: TiltTest) -> int:
        """Finds the index of a press's support line among all."""
        return self.support_rests.index(_get_support_rest(press))

    @cached_property
    def rests(self) -> list[tuple[float, ...]]:
        """The different poses of all weighings; weighings with the very same pose share it."""
        made: list[TiltTest | LiftTest] = [*self.log.presses, *self.log.lifts]
        poses = [one.pose for one in made]
        return list(dict.fromkeys(tuple(pose.tolist()) for pose in poses))

    @property
    def size(self) -> int:
        """Number of unknowns."""
        known = WANTED_UNKNOWNS + 3 * len(self.rests) + len(self.log.presses)
        return known + len(self.support_rests)

    def make_prior(self) -> tuple[Array, Array]:
        """Mean (N,) of the unknowns beforehand, and the root (N, N) of their covariance.

        The errors of poses and edges are unknowns in units of their standard deviations, and so
        are the logarithms of the distances of support lines.
        """
        mass, mass_std = self.prior.log_mass
        friction, friction_std = self.prior.log_friction
        mean = np.zeros(self.size)
        mean[:WANTED_UNKNOWNS] = (mass, *self.center, friction)
        root = np.eye(self.size)
        root[LOG_MASS, LOG_MASS] = mass_std
        root[CENTER_INDICES, CENTER_INDICES] = np.linalg.cholesky(self.center_covariance)
        root[LOG_FRICTION, LOG_FRICTION] = friction_std
        return mean, root

    def calc_residuals(self, u: Array) -> tuple[Array, Array]:
        """Calculates the residuals of the observations, each over its standard deviation.

        Args:
            u: (N,) the unknowns.

        Returns:
            The residuals (M,), and their derivatives (M, N).
        """
        rests = self.rests
        residuals: list[float] = []
        rows: list[Array] = []
        for i, line in enumerate(self.tilting_lines):
            if line != TiltingLine.NONE:
                r, row = self.calc_press(u, i, line)
                residuals.append(r)
                rows.append(row)
        for lift in self.log.lifts:
            rest = WANTED_UNKNOWNS + 3 * rests.index(tuple(lift.pose.tolist()))
            r_lift, row_lift = self._calc_lift(u, lift, rest)
            residuals.extend(r_lift)
            rows.extend(row_lift)
        if self.force is not None:
            # log K = log mu + log m + log g
            log_scale = u[LOG_MASS] + u[LOG_FRICTION] + np.log(self.gravity)
            std = self.force.relative_std
            row = np.zeros(self.size)
            row[[LOG_MASS, LOG_FRICTION]] = 1 / std
            residuals.append(float(log_scale - np.log(self.force.friction)) / std)
            rows.append(row)
        return np.array(residuals), np.array(rows).reshape(-1, self.size)

    def _place_center(self, u: Array, pose: Array, rest: int) -> tuple[Array, Array]:
        """Calculates where the center of mass is in W, and the derivatives.

        Args:
            u: (N,) the unknowns.
            pose: (3,) X_WB as it was seen.
            rest: index of the first of the pose's three errors among the unknowns.

        Returns:
            c_W (2,), m, and its derivatives (2, N).
        """
        position = self.noise.position
        angle = self.noise.angle
        p = pose[:2] + position * u[rest : rest + 2]
        R = make_rotation(pose[2] + angle * u[rest + 2])
        arm = R @ u[CENTER_INDICES]
        J = np.zeros((2, self.size))
        J[:, CENTER_INDICES] = R
        J[:, rest : rest + 2] = position * np.eye(2)
        # d(R c)/dtheta is R c, turned left.
        J[:, rest + 2] = angle * turn_left(arm)
        return p + arm, J

    def calc_press(self, u: Array, index: int, line: TiltingLine) -> tuple[float, Array]:
        """Calculates the residual of a press, and its derivatives (N,).

        Args:
            u: (N,) the unknowns.
            index: of the press.
            line: about which line the object tilted: the edge or supports.
        """
        press = self.log.presses[index]
        rest = WANTED_UNKNOWNS + 3 * self.rests.index(tuple(press.pose.tolist()))
        edge = WANTED_UNKNOWNS + 3 * len(self.rests) + index
        weight = self.gravity * np.exp(u[LOG_MASS])
        c_W, J_c = self._place_center(u, press.pose, rest)
        n = press.normal
        # F = m g b / a, with the edge by e farther out than it is said to be; about a line D inside
        # the edge, b is shorter and a longer by D.
        std = float(np.hypot(self.noise.edge, SHIFT_UNCERTAINTY * press.center_shift))
        e = std * float(u[edge])
        b = float(n @ (press.edge_point - c_W)) - press.center_shift + e
        a = press.arm - e
        support = 0
        D = 0.0
        if line == TiltingLine.SUPPORTS:
            first = WANTED_UNKNOWNS + 3 * len(self.rests) + len(self.log.presses)
            support = first + self.find_support_rest(press)
            D = LINE_DISTANCE * float(np.exp(LINE_SPREAD * u[support]))
        force = weight * (b - D) / (a + D)
        row = -weight / (a + D) * (n @ J_c)
        row[LOG_MASS] = force
        row[edge] = (weight + force) / (a + D) * std
        if line == TiltingLine.SUPPORTS:
            row[support] = -(weight + force) / (a + D) * D * LINE_SPREAD
        return float(force - press.force) / press.force_std, row / press.force_std

    def _calc_lift(self, u: Array, lift: LiftTest, rest: int) -> tuple[list[float], list[Array]]:
        """Calculates the residuals of a lift, and their derivatives (N,) each."""
        weight = self.gravity * np.exp(u[LOG_MASS])
        row = np.zeros(self.size)
        row[LOG_MASS] = weight
        residuals = [float(weight - lift.weight) / lift.weight_std]
        rows = [row / lift.weight_std]
        if lift.torque is None:
            return residuals, rows
        # torque = m g (-l_y, l_x)
        c_W, J_c = self._place_center(u, lift.pose, rest)
        torque = weight * turn_left(c_W - lift.place)
        J = weight * np.stack([-J_c[1], J_c[0]])
        J[:, LOG_MASS] = torque
        residuals.extend(((torque - lift.torque) / lift.torque_std).tolist())
        rows.extend(J / lift.torque_std)
        return residuals, rows


@dataclass(frozen=True, eq=False)
class AbsoluteFit:
    """The least squares of a problem, solved.

    Attributes:
        problem: the problem.
        v: (N,) the unknowns in standard deviations of their prior.
        u: (N,) the unknowns.
        covariance: (N, N) of u, by Laplace's approximation.
        loss: half the sum of squares, priors included.
        log_determinant: of the Hessian by v.
        observations: number of residuals.
    """

    problem: MassProblem
    v: Array
    u: Array
    covariance: Array
    loss: float
    log_determinant: float
    observations: int

    @property
    def agreement(self) -> float:
        """Probability of observations that agree as badly as these do, or worse.

        At the minimum the whole sum of squares, priors included, is a chi square with as many
        degrees of freedom as there are observations.
        """
        return float(chdtrc(self.observations, 2 * self.loss))


def fit_absolute(problem: MassProblem, near: AbsoluteFit | None = None) -> AbsoluteFit:
    """Solves the least squares.

    Args:
        problem: what was observed, and what was held beforehand.
        near: the fit of the same observations with other tilting lines, to begin with.
    """
    mean, root = problem.make_prior()
    starts = []
    if near is None:
        for sigmas in START_SIGMAS:
            start = np.zeros(problem.size)
            start[LOG_MASS] = sigmas
            starts.append(start)
    else:
        # Support lines come last.
        shared = problem.size - len(problem.support_rests)
        starts.append(np.append(near.v[:shared], np.zeros(problem.size - shared)))
    found = [_minimize(problem, mean, root, start) for start in starts]
    loss, v = min(found, key=lambda one: one[0])
    u = mean + root @ v
    residuals, J = problem.calc_residuals(u)
    # Laplace: the covariance is the inverse of the Gauss-Newton Hessian.
    by_v = J @ root
    H = np.eye(problem.size) + by_v.T @ by_v
    covariance = root @ np.linalg.inv(H) @ root.T
    return AbsoluteFit(
        problem=problem,
        v=v,
        u=u,
        covariance=(covariance + covariance.T) / 2,
        loss=loss,
        log_determinant=float(np.linalg.slogdet(H)[1]),
        observations=len(residuals),
    )


def _get_support_rest(press: TiltTest) -> tuple[float, ...]:
    """What presses have in common that rock about one support line: pose and edge."""
    return (*press.pose.tolist(), *press.edge_point.tolist(), press.edge_angle)


def _minimize(problem: MassProblem, mean: Array, root: Array, start: Array) -> tuple[float, Array]:
    """Minimizes half the sum of squares, priors included.

    Args:
        problem: the observations.
        mean: (N,) of the unknowns beforehand.
        root: (N, N) of their covariance: u = mean + root v, v ~ N(0, I).
        start: (N,) v to begin with.

    Returns:
        The loss, and v (N,).
    """
    # Residuals and derivatives come together, and both are asked for at the same points.
    latest: dict[bytes, tuple[Array, Array]] = {}

    def calc(u: Array) -> tuple[Array, Array]:
        key = u.tobytes()
        if key not in latest:
            latest.clear()
            latest[key] = problem.calc_residuals(u)
        return latest[key]

    return fit_with_prior(
        lambda u: calc(u)[0], lambda u: calc(u)[1], mean, root, start, FIT_TOLERANCES
    )
