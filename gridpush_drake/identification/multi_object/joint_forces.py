"""What measured forces add to the poses of several objects: how heavy each is, and beside others.

The pusher's force balances the friction of all objects that it moves. With f_j the force that the
model says, and f_bj its part that object b takes, so that f_j is the sum of the f_bj, each push
p measures (`absolute.force_scale`)

    log(K_p / K) = log sum_b a_pb exp(l_b + c) + e_p,    a_pb = sum_j f_j·f_bj / sum_j f_j·f_j

K is the whole friction of the model, l_b how far log of object b's whole load is from the model's,
and c what all objects have in common, of which poses tell nothing. e_p has the variance
`PUSH_STD`² and that of the noise of single forces. The l_b = J_b dz are a function of the unknowns,
dz ~ N(0, S) by the poses. So a few steps of Gauss and Newton give dz and c, and their covariance.
Objects that never pushed each other can so be compared, if each was pushed with its force measured.
Theory: `docs/theory/identification.md`, section 12.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.identification.absolute.force_scale import PUSH_STD, ForceScale, measure_pushes
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.statistics.problem import TimedPush
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.plausibility import explain_unused_forces
from gridpush_drake.pushes.push_log import PushLog

COMMON_STD = 10.0
"""Standard deviation of c before forces are looked at: nothing is known of it."""

NEWTON_STEPS = 5
"""Number of steps by which dz and c are found. The logarithm of a sum is all that is not linear."""

TAKEN_FRACTION = 0.05
"""An object counts as pushed with its force measured where it takes this fraction of a force."""


@dataclass(frozen=True, eq=False)
class JointForces:
    """What the measured forces say.

    Attributes:
        z: (Z,) the unknowns by poses and forces.
        covariance: (Z, Z) of z.
        scales: (N,) the friction of each object that the table can carry.
    """

    z: Array
    covariance: Array
    scales: tuple[ForceScale, ...]

    def rescale(self, bodies: Bodies) -> list[CellParameters]:
        """Gives the parameters (N,) of each object the scale of the forces; see `ForceScale`."""
        return [
            scale.rescale(Model(obj, params))
            for scale, (obj, params) in zip(self.scales, bodies, strict=True)
        ]


def learn_from_forces(
    model: Model, z: Array, covariance: Array, log: PushLog
) -> JointForces | None:
    """Learns from the forces of slow pushes.

    Args:
        model: the objects as the poses have them.
        z: (Z,) their unknowns, see `joint_problem`.
        covariance: (Z, Z) of z.
        log: the pushes learned from, some with forces.

    Returns:
        What they say; None where no force was measured while an object was pushed steadily, or they
        cannot be true.
    """
    physics = model.physics
    if explain_unused_forces(model.objects, log, physics.inertial) is not None:
        return None
    timed = [TimedPush.of(seen, physics.regime) for seen in log if seen.force is not None]
    if not timed:
        return None
    measured = measure_pushes(model, timed)
    if not measured.is_trusted:
        return None
    right = measured.right

    # The observations y_p, their noise, and l = J dz.
    loads = [params.friction * params.mass for params in model.parameters]
    whole = physics.gravity * sum(float(each.sum()) for each in loads)
    seen = np.log(measured.scales[right] / whole)
    noise = PUSH_STD**2 + (measured.stds[right] / measured.scales[right]) ** 2
    a = measured.taken[right]
    J = np.zeros((len(loads), len(z) + 1))
    for b, cells in enumerate(_list_cells(model)):
        J[b, cells] = loads[b] / loads[b].sum()
    J[:, -1] = 1.0

    # x = (dz, c) ~ N(0, P) beforehand; y = log sum_b a_b exp(J_b x) + e
    P = block_diag(covariance, COMMON_STD**2)
    x = np.zeros(len(P))
    for _ in range(NEWTON_STEPS):
        parts = a * np.exp(J @ x)
        total = parts.sum(axis=1)
        H = (parts / total[:, None]) @ J
        gain = np.linalg.solve(H @ P @ H.T + np.diag(noise), H @ P).T
        x = gain @ (seen - np.log(total) + H @ x)
    P = P - gain @ H @ P
    std = np.sqrt(np.maximum(np.diag(J @ P @ J.T), 0.0))
    scales = tuple(
        ForceScale(
            friction=float(physics.gravity * loads[b].sum() * np.exp(J[b] @ x)),
            relative_std=float(std[b]),
            pushes=int((a[:, b] > TAKEN_FRACTION).sum()),
            against=measured.against,
            gravity=physics.gravity,
        )
        for b in range(len(loads))
    )
    return JointForces(z + x[:-1], (P[:-1, :-1] + P[:-1, :-1].T) / 2, scales)


def _list_cells(model: Model) -> list[IntArray]:
    """Lists the places in z of each object's cells."""
    ends = np.cumsum([obj.n for obj in model.objects])
    return [np.arange(end - obj.n, end) for obj, end in zip(model.objects, ends, strict=True)]
