"""The least-squares problem behind identification: predicted against observed poses, with exact derivatives.

The unknowns are z = (log k_1 .. log k_n, log mu_c), with k_i = mu_i m_i the friction each cell
carries (relative to g) and mu_c the contact friction. Each observed pose gives the residual

    r = (dx_c, dy_c, rho dtheta),    so that |r|² is the mean squared distance of the cells' points

with (x_c, y_c) the cells' centroid, its error in the observed body's axes, and rho the radius of
gyration. The cells' frictions mu_i stay those of the prior and the masses follow, m_i = k_i / mu_i;
slow pushes cannot tell the two apart (`identifiability`).
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.motion import Motion
from gridpush_drake.dynamics.physics import DEFAULT_PHYSICS, Physics, Regime
from gridpush_drake.dynamics.push import make_times_with
from gridpush_drake.dynamics.push_batch import BatchPush, PushBatch
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.geometry.se2 import Array, rotate, transform, wrap_angle
from gridpush_drake.identification.posterior import CELLS, CONTACT_FRICTION, GLOBALS
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

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
        rows: (K,) the observations' among them, or those nearest to them.
        table: (K, 2) corners in W of the table's top, m; None where its edge is far.
    """

    observed: ObservedPush
    times: Array
    rows: NDArray[np.int64]
    table: Array | None = None

    @classmethod
    def of(cls, observed: ObservedPush, regime: Regime, table: Array | None = None) -> "TimedPush":
        """Cuts the time at every observation."""
        times = make_times_with(observed.push, observed.t_observed, regime)
        rows = np.searchsorted((times[:-1] + times[1:]) / 2, observed.t_observed)
        return cls(observed, times, rows, table)

    def simulate(
        self, obj: GridObject, params: CellParameters, physics: Physics, **options: Any
    ) -> Motion:
        """Simulates the push from its first observed pose, with further `options` of `simulate`."""
        return simulate(
            obj,
            params,
            self.observed.push,
            self.observed.pose,
            physics=physics,
            times=self.times,
            table=self.table,
            **options,
        )


@dataclass(frozen=True, eq=False)
class Linearization:
    """Residuals and their derivatives, one entry a push.

    Attributes:
        residuals: (3K,) m.
        by_z: (3K, n+1).
        by_inputs: (3K, 5) by the place (x, y) where the push begins, by log mu_c, and by a shift
            (x, y) of the center of the load, all loads tilted along it.
    """

    residuals: list[Array]
    by_z: list[Array]
    by_inputs: list[Array]

    def choose(self, pushes: Sequence[int]) -> "Linearization":
        """Those of some pushes."""
        chosen = (
            [values[i] for i in pushes] for values in (self.residuals, self.by_z, self.by_inputs)
        )
        return Linearization(*chosen)


def resolve_physics(
    physics: Physics, obj: GridObject, log: PushLog, params: CellParameters | None = None
) -> Physics:
    """Replaces the regime "auto" by the one that suits a log's fastest push.

    Args:
        physics: of the log's simulations.
        obj: the object.
        log: its pushes; one regime is chosen for all of them.
        params: what the object is taken to weigh and rub; by default the friction is the prior's.

    Returns:
        The physics, see `Physics.resolve`.
    """
    if physics.regime != "auto":
        return physics
    fastest = max((seen.push.length / seen.push.duration for seen in log), default=0.0)
    if params is not None:
        return physics.resolve_for(obj, params, fastest)
    return physics.resolve(obj, obj.prior.friction, fastest)


class PushProblem:
    """Residuals of a log as a function of z, for one object and physics.

    Attributes:
        obj: the object.
        physics: of the simulations; its regime is never "auto".
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
            physics: of the simulations; `Physics()` by default. The regime "auto" becomes the one
                of the log's fastest push, see `resolve_physics`.
        """
        self.obj = obj
        self.physics = resolve_physics(physics or DEFAULT_PHYSICS, obj, log)
        self._held = held
        self._spent = [0]
        self._pushes = [TimedPush.of(push, self.physics.regime, log.table) for push in log]
        self._centroid = obj.p_BC.mean(axis=0)
        self._rho = obj.radius_of_gyration
        arm = obj.p_BC - self._centroid
        self._tilts = np.linalg.solve(
            arm.T @ arm / obj.n + SINGULAR * self._rho**2 * np.eye(2), arm.T
        ).T

    @property
    def simulations(self) -> int:
        """Pushes simulated so far."""
        return self._spent[0]

    def __len__(self) -> int:
        """Number of pushes."""
        return len(self._pushes)

    def replace_log(self, log: PushLog) -> "PushProblem":
        """The same problem of another log; simulations are counted together."""
        return self._take([TimedPush.of(push, self.physics.regime, log.table) for push in log])

    def choose(self, pushes: Sequence[int]) -> "PushProblem":
        """The same problem of some of its pushes; simulations are counted together."""
        return self._take([self._pushes[i] for i in pushes])

    def move_cells(self, p_BC: Array) -> "PushProblem":
        """The same problem with the loads of the cells at other places, (n, 2) m; simulations are counted together."""
        other = self._take(self._pushes)
        other.obj = replace(self.obj, p_BC=p_BC)
        return other

    def _take(self, pushes: list[TimedPush]) -> "PushProblem":
        other = copy(self)
        other.__dict__.pop("_observed", None)
        other._pushes = pushes
        return other

    def params(self, z: Array) -> CellParameters:
        """The cells' parameters at z (n+1,)."""
        mass = np.exp(z[CELLS]) / self._held.friction
        return replace(self._held, mass=mass, contact_friction=float(np.exp(z[CONTACT_FRICTION])))

    def calc_tilt_covariance(self, std: float) -> Array:
        """(n+1, n+1) of z where the load's center is off by `std` per axis, m, all loads tilted along it."""
        tilts = np.zeros((self.obj.n + len(GLOBALS), 2))
        tilts[CELLS] = std * self._tilts
        return np.asarray(tilts @ tilts.T)

    def unknowns(self, params: CellParameters) -> Array:
        """The unknowns z (n+1,) of some parameters."""
        k, contact_friction = (
            params.mass * self._held.friction,
            max(params.contact_friction, FRICTION_FLOOR),
        )
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
        params, n = self.params(z), self.obj.n
        poses, J = self._observed.batch.differentiate(params)
        J[..., :n] *= params.mass
        J[..., n] *= params.contact_friction
        J = self._to_residuals(poses, J)
        inputs = np.concatenate([J[:, [n + 1, n + 2, n]], J[:, :n] @ self._tilts], axis=1)
        residuals = self._calc_residuals(poses).ravel()
        return Linearization(
            self._split(residuals), self._split(J[:, : n + 1]), self._split(inputs)
        )

    def touched(self, z: Array) -> NDArray[np.bool_]:
        """Whether the pusher touches the object, by push."""
        self._spent[0] += len(self)
        return self._observed.batch.simulate(self.params(z))[1]

    def calc_cell_errors(self, residuals: Sequence[Array]) -> Array:
        """Mean distance of the cells' centers, m, by push: the paper's ADD, averaged over a push's observations."""
        if not len(residuals):
            return np.empty(0)
        rows, counts = (
            np.concatenate(residuals).reshape(-1, 3),
            np.array([len(one) // 3 for one in residuals]),
        )
        arm = self.obj.p_BC - self._centroid
        x, y, turn = rows[:, 0], rows[:, 1], rows[:, 2] / self._rho
        c, s = -2.0 * np.sin(turn / 2) ** 2, np.sin(turn)  # the rotation less the identity
        cells = np.vstack([np.ones(self.obj.n), arm.T])
        moved_x, moved_y = np.column_stack([x, c, -s]) @ cells, np.column_stack([y, s, c]) @ cells
        errors = np.sqrt(moved_x**2 + moved_y**2).mean(axis=1)
        return np.asarray(np.add.reduceat(errors, np.append(0, np.cumsum(counts[:-1]))) / counts)

    @cached_property
    def _observed(self) -> "_Observations":
        pushes = [
            BatchPush(p.observed.push, p.observed.pose, p.times, p.rows, p.table)
            for p in self._pushes
        ]
        poses = np.concatenate(
            [np.empty((0, 3)), *(p.observed.poses_observed for p in self._pushes)]
        )
        return _Observations(
            PushBatch(self.obj, pushes, self.physics), poses, self._centroid_at(poses)
        )

    def _split(self, values: Array) -> list[Array]:
        """Cuts (3R, ...) of all pushes into those of each."""
        ends = (3 * self._observed.batch.offsets).tolist()
        return [values[begin:end] for begin, end in pairwise(ends)]

    def _calc_residuals(self, predicted: Array) -> Array:
        """(R, 3) of all pushes' predicted poses (R, 3)."""
        observed, centroids = self._observed.poses, self._observed.centroids
        shift = rotate(-observed[:, 2], self._centroid_at(predicted) - centroids)
        return np.column_stack([shift, self._rho * wrap_angle(predicted[:, 2] - observed[:, 2])])

    def _centroid_at(self, poses: Array) -> Array:
        return transform(poses, self._centroid[None])[:, 0]

    def _to_residuals(self, predicted: Array, J: Array) -> Array:
        """Turns derivatives of the predicted poses, (R, 3, p), into those of the residuals, (3R, p)."""
        arm = self._centroid_at(predicted) - predicted[:, :2]
        c, s = np.cos(self._observed.poses[:, 2:]), np.sin(self._observed.poses[:, 2:])
        x, y = J[:, 0] - arm[:, 1:] * J[:, 2], J[:, 1] + arm[:, :1] * J[:, 2]
        return np.stack([c * x + s * y, c * y - s * x, self._rho * J[:, 2]], axis=1).reshape(
            -1, J.shape[2]
        )


@dataclass(frozen=True, eq=False)
class _Observations:
    """All pushes' observations, one after another.

    Attributes:
        batch: simulates the pushes.
        poses: (R, 3) observed.
        centroids: (R, 2) the cells' centroid there, m.
    """

    batch: PushBatch
    poses: Array
    centroids: Array
