"""The least-squares problem behind identification: predicted against observed poses, with exact derivatives.

The unknowns are z = (log k_1 .. log k_n, log mu_c), with k_i = mu_i m_i the friction each cell carries (relative to g)
and mu_c the contact friction. Each observed pose gives the residual

    r = (dx_c, dy_c, rho dtheta),    so that |r|² is the mean squared distance of the cells' points

with (x_c, y_c) the cells' centroid, its error in the observed body's axes, and rho the radius of gyration. The cells'
frictions mu_i stay those of the prior and the masses follow, m_i = k_i / mu_i; slow pushes cannot tell the two apart
(`identifiability`).
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.motion import Motion, MotionStatus
from gridpush_drake.dynamics.simulation import Regime, simulate
from gridpush_drake.dynamics.time_grid import make_path_times
from gridpush_drake.geometry.se2 import rotate, transform, wrap_angle
from gridpush_drake.identification.posterior import CELLS, CONTACT_FRICTION, GLOBALS
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

Array = NDArray[np.float64]

SHIFT = slice(3, 5)
"""The columns of `Linearization.by_inputs` by the shift of the load's center."""

SINGULAR = 1e-6
"""Of the squared radius of gyration, by which a row of cells is taken to be wide."""

FRICTION_FLOOR = 1e-6
"""Least contact friction whose logarithm is taken."""


@dataclass(frozen=True, eq=False)
class TimedPush:
    """A push with the simulation times that include its observations.

    Attributes:
        observed: the push.
        times: (T+1,) s from its beginning.
        rows: (K,) the observations' among them.
        table: (K, 2) corners in W of the table's top, m; None where its edge is far.
    """

    observed: ObservedPush
    times: Array
    rows: NDArray[np.int64]
    table: Array | None = None

    @classmethod
    def of(cls, observed: ObservedPush, regime: Regime, table: Array | None = None) -> "TimedPush":
        """Cuts the time at every observation."""
        times = np.union1d(make_path_times(observed.push, regime), observed.t_observed)
        return cls(observed, times, np.searchsorted(times, observed.t_observed), table)

    def simulate(self, obj: GridObject, params: CellParameters, **options: Any) -> Motion:
        """Simulates the push from its first observed pose, with `options` of `simulate`."""
        push, pose = self.observed.push, self.observed.pose
        return simulate(obj, params, push, pose, times=self.times, table=self.table, **options)


@dataclass(frozen=True, eq=False)
class Linearization:
    """Residuals and their derivatives, one entry a push.

    Attributes:
        residuals: (3K,) m.
        by_z: (3K, n+1).
        by_inputs: (3K, 5) by the place (x, y) where the push begins, by log mu_c, and by a shift (x, y) of the center
            of the load, all loads tilted along it.
    """

    residuals: list[Array]
    by_z: list[Array]
    by_inputs: list[Array]


class PushProblem:
    """Residuals of a log as a function of z, for one object and regime; counts the simulations it makes."""

    def __init__(self, obj: GridObject, log: PushLog, friction: Array, regime: Regime = "quasi_static") -> None:
        """Prepares the log.

        Args:
            obj: the object.
            log: the training pushes, each with at least one later observation.
            friction: (n,) the cells' friction coefficients against the support, held fixed.
            regime: "quasi_static" or "inertial".
        """
        self.obj = obj
        self.friction = np.asarray(friction, dtype=np.float64)
        self.regime = regime
        self._spent = [0]
        self._pushes = [TimedPush.of(push, regime, log.table) for push in log]
        self._centroid = obj.p_BC.mean(axis=0)
        self._rho = obj.radius_of_gyration
        arm = obj.p_BC - self._centroid
        self._tilts = np.linalg.solve(arm.T @ arm / obj.n + SINGULAR * self._rho**2 * np.eye(2), arm.T).T

    @property
    def simulations(self) -> int:
        """Pushes simulated so far."""
        return self._spent[0]

    def __len__(self) -> int:
        """Number of pushes."""
        return len(self._pushes)

    def replace_log(self, log: PushLog) -> "PushProblem":
        """The same problem of another log; simulations are counted together."""
        other = copy(self)
        other._pushes = [TimedPush.of(push, self.regime, log.table) for push in log]
        return other

    def choose(self, pushes: Sequence[int]) -> "PushProblem":
        """The same problem of some of its pushes; simulations are counted together."""
        other = copy(self)
        other._pushes = [self._pushes[i] for i in pushes]
        return other

    def params(self, z: Array) -> CellParameters:
        """The cells' parameters at z (n+1,)."""
        mass, contact_friction = np.exp(z[CELLS]) / self.friction, float(np.exp(z[CONTACT_FRICTION]))
        return CellParameters(mass, self.friction, contact_friction, self.obj.prior.push_height or 0.0)

    def calc_tilt_covariance(self, std: float) -> Array:
        """(n+1, n+1) of z where the load's center is off by `std` per axis, m, all loads tilted along it."""
        tilts = np.zeros((self.obj.n + len(GLOBALS), 2))
        tilts[CELLS] = std * self._tilts
        return np.asarray(tilts @ tilts.T)

    def unknowns(self, params: CellParameters) -> Array:
        """The unknowns z (n+1,) of some parameters."""
        return np.append(np.log(params.mass * self.friction), np.log(max(params.contact_friction, FRICTION_FLOOR)))

    def residuals(self, z: Array, pushes: Sequence[int] | None = None) -> list[Array]:
        """The residuals (3 K,) of each push (of those chosen), m."""
        return [self._residual(push, simulation) for push, simulation in self._simulate(z, pushes, gradients=False)]

    def linearize(self, z: Array, pushes: Sequence[int] | None = None) -> Linearization:
        """The residuals of each push (of those chosen) and their exact derivatives at z."""
        params, n = self.params(z), self.obj.n
        linear = Linearization([], [], [])
        for push, simulation in self._simulate(z, pushes, gradients="mass"):
            J = simulation.jacobian
            columns = np.empty((len(push.rows), 3, n + 3))
            columns[..., :n] = J.mass * params.mass
            columns[..., n] = J.contact_friction * params.contact_friction
            columns[..., n + 1 :] = J.start
            derivatives = self._to_residual(push, simulation, columns)
            linear.residuals.append(self._residual(push, simulation))
            linear.by_z.append(derivatives[:, : n + 1])
            shift = derivatives[:, :n] @ self._tilts
            linear.by_inputs.append(np.concatenate([derivatives[:, [n + 1, n + 2, n]], shift], axis=1))
        return linear

    def touched(self, z: Array) -> NDArray[np.bool_]:
        """Whether the pusher touches the object, by push."""
        return np.array([sim.status != MotionStatus.NO_CONTACT for _, sim in self._simulate(z, None, gradients=False)])

    def calc_cell_errors(self, residuals: Sequence[Array]) -> Array:
        """Mean distance of the cells' centers, m, by push: the paper's ADD, averaged over a push's observations."""
        return np.array([self._cell_error(residual.reshape(-1, 3)) for residual in residuals])

    def _cell_error(self, residual: Array) -> float:
        arm = self.obj.p_BC - self._centroid
        moved = residual[:, None, :2] + rotate(residual[:, 2:] / self._rho, arm) - arm
        return float(np.linalg.norm(moved, axis=-1).mean())

    def _simulate(
        self, z: Array, pushes: Sequence[int] | None, gradients: Literal["mass"] | bool
    ) -> list[tuple[TimedPush, Motion]]:
        params = self.params(z)
        chosen = self._pushes if pushes is None else [self._pushes[i] for i in pushes]
        self._spent[0] += len(chosen)
        return [
            (push, push.simulate(self.obj, params, regime=self.regime, gradients=gradients, record=push.rows))
            for push in chosen
        ]

    def _residual(self, push: TimedPush, simulation: Motion) -> Array:
        predicted, observed = simulation.poses[push.rows], push.observed.poses_observed
        shift = rotate(-observed[:, 2], self._centroid_at(predicted) - self._centroid_at(observed))
        return np.column_stack([shift, self._rho * wrap_angle(predicted[:, 2] - observed[:, 2])]).ravel()

    def _centroid_at(self, poses: Array) -> Array:
        return transform(poses, self._centroid[None])[:, 0]

    def _to_residual(self, push: TimedPush, simulation: Motion, J: Array) -> Array:
        """Turns derivatives of the poses (K, 3, p) into those of the residual (3K, p)."""
        arm = self._centroid_at(simulation.poses[push.rows]) - simulation.poses[push.rows, :2]
        c, s = np.cos(push.observed.poses_observed[:, 2:]), np.sin(push.observed.poses_observed[:, 2:])
        x, y = J[:, 0] - arm[:, 1:] * J[:, 2], J[:, 1] + arm[:, :1] * J[:, 2]
        return np.stack([c * x + s * y, c * y - s * x, self._rho * J[:, 2]], axis=1).reshape(-1, J.shape[2])
