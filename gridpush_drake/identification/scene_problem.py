"""The residuals of a log of several objects as a function of all unknowns: `SceneProblem`.

The unknowns are z = (log k of every object's cells; log of the frictions with the pusher; log of
the pairs' frictions); see `scene_learning`.
"""

from collections.abc import Sequence

import numpy as np

from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import make_times_with
from gridpush_drake.dynamics.scene.bodies import Scene, SceneBody
from gridpush_drake.dynamics.scene.motion import SceneJacobian
from gridpush_drake.dynamics.scene.simulation import simulate_scene
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.problem import make_even_parameters
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.scene_log import ObservedScenePush, SceneLog


class SceneProblem:
    """Simulates the pushes of a log with what z says of the objects.

    Attributes:
        objects: the N objects.
        log: their pushes.
        z0: (Z,) the unknowns of even objects.
        push_of_block: (B,) number of the push that each block of residuals belongs to.
        simulations: number of pushes that were simulated so far.
    """

    def __init__(
        self,
        objects: Sequence[GridObject],
        log: SceneLog,
        pair_friction: float,
        noise: Array,
        physics: Physics,
    ) -> None:
        """Takes what is known beforehand.

        Args:
            objects: the objects.
            log: their pushes, at least one.
            pair_friction: friction of two objects against each other that is expected.
            noise: (3,) standard deviations of poses, m, m and rad.
            physics: spin, gravity and tolerances.
        """
        self.objects = tuple(objects)
        self.log = log
        self.simulations = 0
        self.push_of_block = np.repeat(np.arange(len(log)), [len(seen.t_observed) for seen in log])
        self._noise = noise
        self._physics = physics
        self._even = [make_even_parameters(obj) for obj in objects]
        n = len(objects)
        self._pairs = np.triu_indices(n, 1)
        k = [np.log(each.mass * each.friction) for each in self._even]
        finger = np.log([each.contact_friction for each in self._even])
        pair = np.full(len(self._pairs[0]), np.log(pair_friction))
        self.z0 = np.concatenate([*k, finger, pair])

    def make_scene(self, z: Array, poses: Array) -> Scene:
        """Makes the scene of z at poses (N, 3), m and rad."""
        params, friction = self._make_params(z)
        bodies = [
            SceneBody(obj, each, pose)
            for obj, each, pose in zip(self.objects, params, poses, strict=True)
        ]
        return Scene(bodies, friction, may_overlap=True)

    def linearize(self, z: Array) -> tuple[Array, Array]:
        """Simulates all pushes, each from where it was seen to begin.

        Returns:
            Residuals (B, 3 N) in units of the noise, a block for each time of each push, and their
            derivatives (B, 3 N, Z) by z.
        """
        residuals = []
        derivatives = []
        for seen in self.log:
            self.simulations += 1
            times = make_times_with(seen.push, seen.t_observed, "quasi_static")
            rows = np.searchsorted(times, seen.t_observed)
            motion = simulate_scene(
                self.make_scene(z, seen.poses),
                seen.push,
                gradients=True,
                physics=self._physics,
                times=times,
                record=rows,
            )
            residuals.append(self._calc_residual(motion.poses[rows], seen))
            by_z = self._chain(z, motion.jacobian) / self._noise[:, None]
            derivatives.append(by_z.reshape(len(rows), -1, len(z)))
        return np.concatenate(residuals), np.concatenate(derivatives)

    def _make_params(self, z: Array) -> tuple[list[CellParameters], Array]:
        """Makes the parameters and the pair frictions (N, N) of z."""
        sizes = [obj.n for obj in self.objects]
        n = len(sizes)
        *logs, finger, pair = np.split(z, np.cumsum([*sizes, n]))
        params = [
            CellParameters(np.exp(log) / even.friction, even.friction, float(np.exp(mu)))
            for log, even, mu in zip(logs, self._even, finger, strict=True)
        ]
        friction = np.zeros((n, n))
        friction[self._pairs] = np.exp(pair)
        return params, friction + friction.T

    def _calc_residual(self, poses: Array, seen: ObservedScenePush) -> Array:
        """Calculates a push's residuals (K, 3 N), in units of the noise."""
        off = poses - seen.poses_observed
        off[..., 2] = np.arctan2(np.sin(off[..., 2]), np.cos(off[..., 2]))
        return np.asarray((off / self._noise).reshape(len(poses), -1))

    def _chain(self, z: Array, jacobian: SceneJacobian) -> Array:
        """Makes the derivatives (K, N, 3, Z) of the poses by z."""
        params, friction = self._make_params(z)
        by_k = [block * each.mass for block, each in zip(jacobian.mass, params, strict=True)]
        finger = jacobian.contact_friction * np.array([each.contact_friction for each in params])
        i, j = self._pairs
        pair = jacobian.pair_friction[..., i, j] * friction[i, j]
        return np.concatenate([*by_k, finger, pair], axis=-1)
