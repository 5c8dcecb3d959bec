"""The residuals of a log of several objects as a function of all unknowns: `JointProblem`.

The unknowns are z = (log k of every object's cells; log of the frictions with the pusher; log of
the pairs' frictions); see `joint_fit`.
"""

from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.motion import Jacobian
from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.statistics.problem import TimedPush, make_even_parameters
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.observed_push import ObservedPush
from gridpush_drake.pushes.push_log import PushLog

MOVED_SIGMAS = 4.0
"""An object counts as moved where it was seen to end this many standard deviations of the noise
from where it lay."""


def find_moved(seen: ObservedPush, noise: tuple[float, float, float]) -> NDArray[np.bool_]:
    """Tells which of N objects a push moved by more than the noise, (N,).

    Args:
        seen: the push.
        noise: standard deviations of poses, m, m and rad.
    """
    off = seen.final_pose - seen.pose
    off[:, 2] = wrap_angle(off[:, 2])
    return np.asarray((np.abs(off) > MOVED_SIGMAS * np.asarray(noise)).any(axis=1))


class JointProblem:
    """Simulates the pushes of a log with what z says of the objects.

    Attributes:
        objects: the N objects.
        log: their pushes.
        z0: (Z,) the unknowns of even objects.
        push_of_block: (B,) number of the push that each block of residuals belongs to.
    """

    def __init__(self, model: Model, log: PushLog | tuple[ObservedPush, ...], noise: Array) -> None:
        """Takes what is known beforehand.

        Args:
            model: the objects, how they slide, and the friction of two against each other that is
                expected.
            log: their pushes, at least one.
            noise: (3,) standard deviations of poses, m, m and rad.
        """
        self.objects = model.objects
        self.log = log
        # A list, so that problems made of this one count their simulations together with it.
        self._spent = [0]
        self.push_of_block = np.repeat(np.arange(len(log)), [len(seen.t_observed) for seen in log])
        self._timed = [TimedPush.of(seen, "quasi_static") for seen in log]
        self._noise = noise
        self._physics = model.physics
        self._even = [make_even_parameters(obj) for obj in model.objects]
        self._pairs = np.triu_indices(len(model), 1)
        k = [np.log(each.mass * each.friction) for each in self._even]
        finger = np.log([each.contact_friction for each in self._even])
        self.z0 = np.concatenate([*k, finger, np.log(model.pair_friction[self._pairs])])

    def move_cells(self, body: int, p_BC: Array) -> "JointProblem":
        """Makes the problem with one object's loads elsewhere; simulations are counted together.

        Args:
            body: number of the object.
            p_BC: (n, 2) where its cells bear their loads, body frame, m.
        """
        objects = list(self.objects)
        if p_BC is objects[body].p_BC:
            return self
        objects[body] = replace(objects[body], p_BC=p_BC)
        other = copy(self)
        other.objects = tuple(objects)
        return other

    def make_model(self, z: Array) -> Model:
        """Makes the model of z."""
        sizes = [obj.n for obj in self.objects]
        n = len(sizes)
        *logs, finger, pair = np.split(z, np.cumsum([*sizes, n]))
        params = [
            CellParameters(np.exp(log) / even.friction, even.friction, float(np.exp(mu)))
            for log, even, mu in zip(logs, self._even, finger, strict=True)
        ]
        friction = np.zeros((n, n))
        friction[self._pairs] = np.exp(pair)
        return Model(self.objects, params, self._physics, friction + friction.T)

    @property
    def simulations(self) -> int:
        """Number of pushes that were simulated so far."""
        return self._spent[0]

    def linearize(self, z: Array) -> tuple[Array, Array]:
        """Simulates all pushes, each from where it was seen to begin.

        Returns:
            Residuals (B, 3 N) in units of the noise, a block for each time of each push, and their
            derivatives (B, 3 N, Z) by z.
        """
        model = self.make_model(z)
        residuals = []
        derivatives = []
        for timed in self._timed:
            self._spent[0] += 1
            motion = timed.simulate(model, gradients=True, record=timed.rows)
            residuals.append(self._calc_residual(motion.poses[timed.rows], timed.observed))
            by_z = self._chain(model, motion.jacobian) / self._noise[:, None]
            derivatives.append(by_z.reshape(len(timed.rows), -1, len(z)))
        return np.concatenate(residuals), np.concatenate(derivatives)

    def _calc_residual(self, poses: Array, seen: ObservedPush) -> Array:
        """Calculates a push's residuals (K, 3 N), in units of the noise."""
        off = poses - seen.poses_observed
        off[..., 2] = np.arctan2(np.sin(off[..., 2]), np.cos(off[..., 2]))
        return np.asarray((off / self._noise).reshape(len(poses), -1))

    def _chain(self, model: Model, jacobian: Jacobian) -> Array:
        """Makes the derivatives (K, N, 3, Z) of the poses by the z of a model."""
        params = model.parameters
        by_k = jacobian.mass * np.concatenate([each.mass for each in params])
        finger = jacobian.contact_friction * np.array([each.contact_friction for each in params])
        i, j = self._pairs
        assert jacobian.pair_friction is not None
        pair = jacobian.pair_friction[..., i, j] * model.pair_friction[i, j]
        return np.concatenate([by_k, finger, pair], axis=-1)
