"""The least-squares problem behind identification: predicted against observed poses, with exact derivatives.

The unknowns are z = (log k_1 .. log k_n, log mu_c), with k_i = mu_i m_i the friction each cell carries (relative to g)
and mu_c the contact friction. Each observed pose gives the residual

    r = (dx_c, dy_c, rho dtheta),    so that |r|² is the mean squared distance of the cells' points

with (x_c, y_c) the cells' centroid and rho the radius of gyration. The cells' frictions mu_i stay those of the prior
and the masses follow, m_i = k_i / mu_i; slow pushes cannot tell the two apart (`identifiability`).
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.simulate import make_path_times, simulate
from gridpush_drake.dynamics.simulation import STATUS_NO_CONTACT, Simulation
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.pushes.log import ObservedPush, PushLog

Array = NDArray[np.float64]

SLOWEST = "quasi_static"


@dataclass(frozen=True, eq=False)
class _TimedPush:
    """A push with the simulation times that include its observations."""

    observed: ObservedPush
    times: Array
    rows: NDArray[np.int64]


class PushProblem:
    """Residuals of a log as a function of z, for one object and regime; counts the simulations it makes."""

    def __init__(self, obj: GridObject, log: PushLog, friction: Array, regime: str = SLOWEST) -> None:
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
        self.simulations = 0
        self._pushes = [_time(push) for push in log]
        self._centroid = obj.p_BC.mean(axis=0)
        self._rho = obj.radius_of_gyration

    def __len__(self) -> int:
        """Number of pushes."""
        return len(self._pushes)

    @property
    def rows_per_push(self) -> list[int]:
        """Number of residuals of each push."""
        return [3 * len(push.rows) for push in self._pushes]

    def params(self, z: Array) -> CellParameters:
        """The cells' parameters at z (n+1,)."""
        return CellParameters(np.exp(z[:-1]) / self.friction, self.friction, float(np.exp(z[-1])))

    def unknowns(self, params: CellParameters) -> Array:
        """z (n+1,) of some parameters."""
        return np.append(np.log(params.mass * self.friction), np.log(max(params.contact_friction, 1e-6)))

    def residuals(self, z: Array, pushes: Sequence[int] | None = None) -> list[Array]:
        """The residuals (3 K,) of each push (of those chosen), m."""
        return [self._residual(push, simulation) for push, simulation in self._simulate(z, pushes, gradients=False)]

    def linearise(self, z: Array, pushes: Sequence[int] | None = None) -> tuple[list[Array], list[Array]]:
        """The residuals (3 K,) of each push and their Jacobian (3 K, n+1) by z, m."""
        params = self.params(z)
        residuals, jacobians = [], []
        for push, simulation in self._simulate(z, pushes, gradients=True):
            residuals.append(self._residual(push, simulation))
            jacobians.append(self._jacobian(simulation, push, params))
        return residuals, jacobians

    def touched(self, z: Array) -> NDArray[np.bool_]:
        """Whether the pusher touches the object, by push."""
        return np.array([sim.status != STATUS_NO_CONTACT for _, sim in self._simulate(z, None, gradients=False)])

    def calc_cell_errors(self, residuals: Sequence[Array]) -> Array:
        """Mean distance of the cells' centres, m, by push: the paper's ADD, averaged over a push's observations."""
        return np.array([self._cell_error(residual.reshape(-1, 3)) for residual in residuals])

    def _cell_error(self, residual: Array) -> float:
        arm = self.obj.p_BC - self._centroid
        theta = residual[:, 2:] / self._rho
        cosine, sine = np.cos(theta) - 1.0, np.sin(theta)
        dx = residual[:, :1] + cosine * arm[:, 0] - sine * arm[:, 1]
        dy = residual[:, 1:2] + sine * arm[:, 0] + cosine * arm[:, 1]
        return float(np.hypot(dx, dy).mean())

    def _simulate(
        self, z: Array, pushes: Sequence[int] | None, gradients: bool
    ) -> list[tuple[_TimedPush, Simulation]]:
        params = self.params(z)
        chosen = self._pushes if pushes is None else [self._pushes[i] for i in pushes]
        self.simulations += len(chosen)

        def run(push: _TimedPush) -> tuple[_TimedPush, Simulation]:
            return push, simulate(
                self.obj, params, push.observed.push, push.observed.pose, times=push.times, regime=self.regime,
                gradients=gradients, record=push.rows,
            )  # type: ignore[call-overload]  # fmt: skip

        with ThreadPoolExecutor(2) as pool:
            return list(pool.map(run, chosen))

    def _residual(self, push: _TimedPush, simulation: Simulation) -> Array:
        predicted, observed = simulation.poses[push.rows], push.observed.poses_observed
        turn = (predicted[:, 2] - observed[:, 2] + np.pi) % (2 * np.pi) - np.pi
        shift = self._centroid_at(predicted) - self._centroid_at(observed)
        return np.column_stack([shift, self._rho * turn]).ravel()

    def _centroid_at(self, poses: Array) -> Array:
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        x, y = self._centroid
        return poses[:, :2] + np.column_stack([c * x - s * y, s * x + c * y])

    def _jacobian(self, simulation: Simulation, push: _TimedPush, params: CellParameters) -> Array:
        J = simulation.jacobian
        by_z = np.concatenate([J.mass * params.mass, (J.contact_friction * params.contact_friction)[..., None]], axis=2)
        arm = self._centroid_at(simulation.poses[push.rows]) - simulation.poses[push.rows, :2]
        theta = by_z[:, 2]
        return np.stack(
            [by_z[:, 0] - arm[:, 1:] * theta, by_z[:, 1] + arm[:, :1] * theta, self._rho * theta], axis=1
        ).reshape(-1, by_z.shape[2])


def _time(observed: ObservedPush) -> _TimedPush:
    """Cuts the time at every observation."""
    times = np.union1d(make_path_times(observed.push), observed.t_observed)
    return _TimedPush(observed, times, np.searchsorted(times, observed.t_observed))
