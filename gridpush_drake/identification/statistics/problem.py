"""The least-squares problem behind identification: predicted against observed poses.

The unknowns are z = (log k_1 .. log k_n, log mu_c), with k_i = mu_i m_i the friction each cell
carries (relative to g) and mu_c the contact friction. Each observed pose gives the residual

    r = (dx_c, dy_c, rho dtheta),    so that |r|² is the mean squared distance of the cells' points

with (x_c, y_c) the cells' centroid, its error in the observed body's axes, and rho the radius of
gyration. The cells' frictions mu_i stay those of the prior and the masses follow, m_i = k_i / mu_i;
slow pushes cannot tell the two apart (`identifiability`). The derivatives are exact. See
`docs/theory/identification.md`, section 1; the noise and the prior are not here but in `noise` and
`hypotheses`.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.motion import Motion
from gridpush_drake.dynamics.physics import DEFAULT_PHYSICS, Physics, Regime
from gridpush_drake.dynamics.push import make_times_with
from gridpush_drake.dynamics.push_batch import BatchPush, PushBatch
from gridpush_drake.dynamics.scene.simulation import simulate_together
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.geometry.se2 import (
    Array,
    IntArray,
    make_rotation,
    rotate,
    transform,
    wrap_angle,
)
from gridpush_drake.identification.statistics.friction_gradient import calc_arms
from gridpush_drake.identification.statistics.posterior import (
    CELL_ENTRIES,
    CONTACT_FRICTION,
    GLOBAL_NAMES,
)
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

SHIFT_COLUMNS = slice(3, 5)
"""Columns of `Linearization.by_inputs` that are the derivatives by a shift of the load's center."""

SINGULAR_FRACTION = 1e-6
"""Fraction of the squared radius of gyration that is added to the cells' spread along both axes, so
that the loads of a single row of cells can be tilted across the row, too."""

MIN_CONTACT_FRICTION = 0.05
"""Smallest coefficient of contact friction that a fit begins with. A prior's smaller one is raised
to it, because the logarithm of the coefficient is an unknown, and zero has none."""

FRICTION_FLOOR = 1e-6
"""Smallest coefficient of contact friction whose logarithm is taken. A smaller one is raised to
it."""


@dataclass(frozen=True, eq=False)
class TimedPush:
    """A push with the simulation times that include its observations.

    Attributes:
        observed: the push.
        times: (T+1,) s from its beginning.
        rows: (K,) indices in `times` of the observations, or of the times nearest to them.
        table: (K, 2) corners in W of the table's top, m; None where its edge is far.
    """

    observed: ObservedPush
    times: Array
    rows: IntArray
    table: Array | None = None

    @classmethod
    def of(cls, observed: ObservedPush, regime: Regime, table: Array | None = None) -> "TimedPush":
        """Cuts the time of a push into steps of which one ends at every observation."""
        times = make_times_with(observed.push, observed.t_observed, regime)
        rows = np.searchsorted((times[:-1] + times[1:]) / 2, observed.t_observed)
        return cls(observed, times, rows, table)

    def simulate(self, bodies: Bodies, **options: Any) -> Motion:
        """Simulates the push from its first observed pose, with further `options` of `simulate`.

        The objects of a log of several may overlap a little, as they were seen; they know no
        table's edge. There may be one of them alone.
        """
        if self.observed.pose.ndim > 1:
            return simulate_together(
                bodies, self.observed.push, self.observed.pose, times=self.times, **options
            )
        return simulate(
            bodies,
            self.observed.push,
            self.observed.pose,
            times=self.times,
            table=self.table,
            **options,
        )


@dataclass(frozen=True, eq=False)
class Linearization:
    """Residuals and their derivatives, one entry a push.

    Attributes:
        residuals: (3K,) m.
        by_z: (3K, n+1) derivatives by z.
        by_inputs: (3K, 5) derivatives by the place (x, y) where the push begins, by log mu_c, and
            by a shift (x, y) of the center of the load, all loads tilted along it. Where any of the
            pushes may come over a table's edge, (3K, 7): also by the gradient (x, y) of the
            friction, see `friction_gradient`.
        by_frame: (3K, 3) derivatives by a motion (x, y, theta) of the whole object, outline and
            cells, in the frame in which its poses are logged; m and rad.
    """

    residuals: list[Array]
    by_z: list[Array]
    by_inputs: list[Array]
    by_frame: list[Array]

    def choose(self, pushes: Sequence[int]) -> "Linearization":
        """Takes the residuals and derivatives of some of the pushes."""
        return Linearization(
            residuals=[self.residuals[i] for i in pushes],
            by_z=[self.by_z[i] for i in pushes],
            by_inputs=[self.by_inputs[i] for i in pushes],
            by_frame=[self.by_frame[i] for i in pushes],
        )


def find_fastest(log: PushLog) -> float:
    """The mean speed of a log's fastest push, m/s; 0 of an empty log.

    It is 0 as well where a push is by another shape than a disc: such pushes are simulated as slow
    ones only, and a log has one regime.
    """
    if any(seen.push.shape is not None for seen in log):
        return 0.0
    return max((seen.push.length / seen.push.duration for seen in log), default=0.0)


def resolve_physics(physics: Physics, obj: GridObject, log: PushLog) -> Physics:
    """Replaces the regime "auto" by the one that suits a log's fastest push.

    Args:
        physics: physics of the log's simulations.
        obj: the object.
        log: its pushes; one regime is chosen for all of them, with the prior's friction.

    Returns:
        The physics, see `Physics.resolve`.
    """
    return physics.resolve(obj, obj.prior.friction, find_fastest(log))


def make_even_parameters(obj: GridObject) -> CellParameters:
    """Makes the parameters that are most probable before any push: every cell is like the others.

    The contact friction is that of the prior, but not less than `MIN_CONTACT_FRICTION`.
    """
    contact_friction = max(obj.prior.contact_friction, MIN_CONTACT_FRICTION)
    return CellParameters.uniform(obj, contact_friction=contact_friction)


class PushProblem:
    """Residuals of a log as a function of z, for one object and physics.

    Attributes:
        obj: the object.
        physics: physics of the simulations; its regime is never "auto".
    """

    def __init__(
        self,
        obj: GridObject,
        log: PushLog,
        held: CellParameters,
        physics: Physics | None = None,
    ) -> None:
        """Prepares the log.

        Args:
            obj: the object.
            log: the training pushes, each with at least one later observation.
            held: parameters, all of which but the masses and the contact friction stay as they are.
            physics: physics of the simulations; `Physics()` by default. The regime "auto" becomes
                the one of the log's fastest push, see `resolve_physics`.
        """
        self.obj = obj
        self.physics = resolve_physics(physics or DEFAULT_PHYSICS, obj, log)
        self._held = held
        # A list, so that problems made of this one count their simulations together with it.
        self._spent = [0]
        self._pushes = [TimedPush.of(push, self.physics.regime, log.table) for push in log]
        self._centroid = obj.p_BC.mean(axis=0)
        self._rho = obj.radius_of_gyration

        # (n, 2) changes of log k, linear in the cells' places, that shift the center of even loads
        # by one meter along x and along y.
        arm = obj.p_BC - self._centroid
        spread = arm.T @ arm / obj.n + SINGULAR_FRACTION * self._rho**2 * np.eye(2)
        self._tilts = np.linalg.solve(spread, arm.T).T

        # (3, 3) by how much a motion (x, y, theta) of the body in its own frame moves its centroid,
        # and turns it at the radius of gyration.
        x, y = self._centroid
        self._centroid_by_frame = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, self._rho]])

    @property
    def simulations(self) -> int:
        """Pushes simulated so far."""
        return self._spent[0]

    def __len__(self) -> int:
        """Number of pushes."""
        return len(self._pushes)

    def replace_log(self, log: PushLog) -> "PushProblem":
        """Makes the problem of another log of the object; simulations are counted together."""
        return self._take([TimedPush.of(push, self.physics.regime, log.table) for push in log])

    def choose(self, pushes: Sequence[int]) -> "PushProblem":
        """Makes the problem of some of the pushes; simulations are counted together."""
        return self._take([self._pushes[i] for i in pushes])

    def move_cells(self, p_BC: Array) -> "PushProblem":
        """Makes the problem with the cells' loads elsewhere; simulations are counted together.

        Args:
            p_BC: (n, 2) the places, body frame, m. Residuals are still those of the cells' centers.
        """
        other = self._take(self._pushes)
        other.obj = replace(self.obj, p_BC=p_BC)
        return other

    def _take(self, pushes: list[TimedPush]) -> "PushProblem":
        """Makes a problem that shares everything with this one but its pushes."""
        other = copy(self)
        # A cached property, which belongs to the pushes.
        other.__dict__.pop("_observed", None)
        other._pushes = pushes
        return other

    def params(self, z: Array) -> CellParameters:
        """The cells' parameters at z (n+1,)."""
        # Section 1: the frictions are held, m_i = k_i / mu_i.
        mass = np.exp(z[CELL_ENTRIES]) / self._held.friction
        return replace(self._held, mass=mass, contact_friction=float(np.exp(z[CONTACT_FRICTION])))

    def calc_tilt_covariance(self, std: float) -> Array:
        """Covariance (n+1, n+1) of z if the center of the load is not known exactly.

        Args:
            std: standard deviation of the center per axis, m. All loads are tilted along it.
        """
        tilts = np.zeros((self.obj.n + len(GLOBAL_NAMES), 2))
        tilts[CELL_ENTRIES] = std * self._tilts
        return np.asarray(tilts @ tilts.T)

    def unknowns(self, params: CellParameters) -> Array:
        """The unknowns z (n+1,) of some parameters, their masses taken with the frictions held."""
        k = params.mass * self._held.friction
        contact_friction = max(params.contact_friction, FRICTION_FLOOR)
        return np.append(np.log(k), np.log(contact_friction))

    def residuals(self, z: Array, pushes: Sequence[int] | None = None) -> list[Array]:
        """The residuals (3 K,) of each push (of those chosen), m."""
        if pushes is not None:
            return self.choose(pushes).residuals(z)
        self._spent[0] += len(self)
        poses, _ = self._observed.batch.simulate(self.params(z))
        return self._split(self._calc_residuals(poses).ravel())

    def linearize(self, z: Array, pushes: Sequence[int] | None = None) -> Linearization:
        """The residuals of each push (of those chosen) and their exact derivatives at z."""
        if pushes is not None:
            return self.choose(pushes).linearize(z)
        self._spent[0] += len(self)
        params = self.params(z)
        n = self.obj.n
        batch = self._observed.batch
        along = calc_arms(self.obj) if batch.near_edge else None
        poses, J = batch.differentiate(params, along)

        # By the logarithms: d/d(log k_i) = m_i d/dm_i, as mu_i is held, and likewise for mu_c.
        J[..., :n] *= params.mass
        J[..., n] *= params.contact_friction
        J = self._to_residuals(poses, J)

        # A motion in the frame of the logged poses moves the object where the push begins, and
        # where it is observed, there straight in the body's axes.
        begins = J[:, n + 3 : n + 6].reshape(-1, 3, 3) @ self._observed.begin_axes
        by_frame = (begins - self._centroid_by_frame).reshape(-1, 3)

        # The inputs of the noise (section 4): the push's place, log mu_c, the load's shift; and the
        # friction's gradient.
        place = J[:, [n + 1, n + 2, n]]
        inputs = np.concatenate([place, J[:, :n] @ self._tilts, J[:, n + 6 :]], axis=1)
        residuals = self._calc_residuals(poses).ravel()
        return Linearization(
            residuals=self._split(residuals),
            by_z=self._split(J[:, : n + 1]),
            by_inputs=self._split(inputs),
            by_frame=self._split(by_frame),
        )

    def touched(self, z: Array) -> NDArray[np.bool_]:
        """Whether the pusher touches the object, by push."""
        self._spent[0] += len(self)
        return self._observed.batch.simulate(self.params(z))[1]

    def calc_cell_errors(self, residuals: Sequence[Array]) -> Array:
        """Mean distance of the cells' centers by push: the paper's ADD, over all its observations.

        Args:
            residuals: (3K,) of each push, m.

        Returns:
            (P,) m.
        """
        if not len(residuals):
            return np.empty(0)
        rows = np.concatenate(residuals).reshape(-1, 3)
        counts = np.array([len(one) // 3 for one in residuals])
        arm = self.obj.p_BC - self._centroid
        x = rows[:, 0]
        y = rows[:, 1]
        turn = rows[:, 2] / self._rho

        # A cell moves by (x, y) + (R - I) arm. The diagonal of R - I, cos - 1, is written so that
        # small turns lose no digits.
        cos_less_1 = -2.0 * np.sin(turn / 2) ** 2
        sin = np.sin(turn)
        cells = np.vstack([np.ones(self.obj.n), arm.T])
        moved_x = np.column_stack([x, cos_less_1, -sin]) @ cells
        moved_y = np.column_stack([y, sin, cos_less_1]) @ cells
        errors = np.sqrt(moved_x**2 + moved_y**2).mean(axis=1)

        # The mean over each push's rows, which stand one push after another.
        begins = np.append(0, np.cumsum(counts[:-1]))
        return np.asarray(np.add.reduceat(errors, begins) / counts)

    @cached_property
    def _observed(self) -> "_Observations":
        """All pushes' observations, prepared when they are first needed."""
        pushes = [
            BatchPush(p.observed.push, p.observed.pose, p.times, p.rows, p.table)
            for p in self._pushes
        ]
        # An empty first entry, for problems without a push.
        observed = [p.observed.poses_observed for p in self._pushes]
        poses = np.concatenate([np.empty((0, 3)), *observed])
        return _Observations(
            batch=PushBatch(self.obj, pushes, self.physics),
            poses=poses,
            centroids=self._centroid_at(poses),
            begin_axes=self._make_begin_axes(),
        )

    def _make_begin_axes(self) -> Array:
        """Makes (R, 3, 3), the axes of the body's frame at the first pose of each row's push."""
        counts = [len(p.rows) for p in self._pushes]
        axes = np.zeros((sum(counts), 3, 3))
        axes[:, :2, :2] = np.repeat(
            make_rotation([p.observed.pose[2] for p in self._pushes]), counts, axis=0
        )
        axes[:, 2, 2] = 1.0
        return axes

    def _split(self, values: Array) -> list[Array]:
        """Cuts (3R, ...) of all pushes into those of each."""
        ends = (3 * self._observed.batch.offsets).tolist()
        return [values[begin:end] for begin, end in pairwise(ends)]

    def _calc_residuals(self, predicted: Array) -> Array:
        """Residuals (R, 3) of the predicted poses (R, 3) of all pushes, m."""
        # Section 1: r = (dx_c, dy_c, rho dtheta), the shift in the observed body's axes.
        theta = self._observed.poses[:, 2]
        shift = rotate(-theta, self._centroid_at(predicted) - self._observed.centroids)
        return np.column_stack([shift, self._rho * wrap_angle(predicted[:, 2] - theta)])

    def _centroid_at(self, poses: Array) -> Array:
        """Centroids (R, 2) of the cells at poses (R, 3), world frame, m."""
        return transform(poses, self._centroid[None])[:, 0]

    def _to_residuals(self, predicted: Array, J: Array) -> Array:
        """Turns derivatives of poses into those of residuals.

        Args:
            predicted: (R, 3) predicted poses.
            J: (R, 3, p) their derivatives.

        Returns:
            (3R, p) derivatives of the residuals.
        """
        # The centroid is q_xy + R(theta) c; a turn moves it at right angles to its arm.
        arm = self._centroid_at(predicted) - predicted[:, :2]
        x = J[:, 0] - arm[:, 1:] * J[:, 2]
        y = J[:, 1] + arm[:, :1] * J[:, 2]

        # Into the axes of the observed body.
        c = np.cos(self._observed.poses[:, 2:])
        s = np.sin(self._observed.poses[:, 2:])
        rows = np.stack([c * x + s * y, c * y - s * x, self._rho * J[:, 2]], axis=1)
        return rows.reshape(-1, J.shape[2])


@dataclass(frozen=True, eq=False)
class _Observations:
    """All pushes' observations, one after another.

    Attributes:
        batch: simulates the pushes.
        poses: (R, 3) the observed poses, m and rad, world frame.
        centroids: (R, 2) the cells' centroids at the observed poses, world frame, m.
        begin_axes: (R, 3, 3) axes of the body's frame where the push begins, world frame; the
            third axis is that of turns.
    """

    batch: PushBatch
    poses: Array
    centroids: Array
    begin_axes: Array
