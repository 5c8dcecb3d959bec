"""`PushBatch`: many pushes of one object, simulated again and again with other parameters.

All of them take one compiled call.

What does not depend on the parameters is prepared once. Each push is simulated just as `simulate`
does it by itself, bit for bit, unless the batch may be approximate. Pushes by other shapes than a
disc are simulated one after another, by the kernels of several objects.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.kernel_call import make_support, run_pushes, shifts_loads
from gridpush_drake.dynamics.kernels.forward_sensitivity import (
    CONTACT_FRICTION,
    POSE_THETA,
    POSE_X,
    START_X,
    START_Y,
)
from gridpush_drake.dynamics.kernels.inputs import Pushes
from gridpush_drake.dynamics.kernels.scene.records import PusherPath, SceneSteps
from gridpush_drake.dynamics.kernels.step import STEP_CONVERGED
from gridpush_drake.dynamics.motion import RawJacobian
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push, measure_steps
from gridpush_drake.dynamics.scene.kernel_call import (
    make_bodies,
    make_pusher_path,
    make_scene_contacts,
    make_scene_state,
    run_scene_kernel,
)
from gridpush_drake.dynamics.scene.simulation import (
    check_shaped_push,
    count_scene_columns,
    place_columns,
)
from gridpush_drake.dynamics.simulation import count_columns, find_edges_near
from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters


class BatchPush(NamedTuple):
    """One push of a batch.

    Attributes:
        push: the pusher's motion.
        pose: (3,) q of the object at the beginning, m and rad.
        times: (T+1,) the steps' times from the push's beginning, s.
        rows: (R,) the poses among the T+1 that are wanted; one may be wanted more than once.
        table: (K, 2) corners in W of the table's top, m; None where it is endless.
    """

    push: Push
    pose: Array
    times: Array
    rows: IntArray
    table: Array | None


class _ShapedPush(NamedTuple):
    """A push by a pusher that is no single disc.

    Attributes:
        place: its place in the batch.
        path: the pusher's path at the steps' times.
        pose: (1, 3) q of the object at the beginning, m and rad.
        dts: (T,) the steps, as `push.measure_steps` has them.
        wanted: (R,) the poses among the T+1 that its rows are.
        row_of_step: (T+1,) the first row that is each pose, -1 for none.
        rows: (R,) the batch's rows that are this push's.
        table: (K, 4) the table's edges, m; None where it is far.
    """

    place: int
    path: PusherPath
    pose: Array
    dts: Array
    wanted: IntArray
    row_of_step: IntArray
    rows: IntArray
    table: Array | None


@dataclass(frozen=True, eq=False)
class _EdgeGroup:
    """Pushes that one call of the kernel takes: those near the same table's edge, or near none."""

    chosen: IntArray  # (P,) which pushes of the batch
    table: Array | None  # (K, 4) the table's edges, m; None where it is far
    pushes: Pushes  # their arrays
    row_of_step: IntArray  # (S+P,) see `rollout_pushes`
    recorded: (
        IntArray  # (R,) the row that records each one's pose: its own, or another of the same pose
    )
    rows: IntArray  # (R,) the batch's rows that those of this group are
    steps: IntArray  # (R,) the step of each row


class PushBatch:
    """Pushes of one object by one physics, prepared to be simulated with many parameters.

    Attributes:
        obj: the object.
        physics: physics of the simulations.
        approximate: whether poses may be a little off, which takes less time.
        offsets: (P+1,) the first row of each push among the wanted poses of all, and their number.
    """

    def __init__(
        self,
        obj: GridObject,
        pushes: Sequence[BatchPush],
        physics: Physics,
        *,
        approximate: bool = False,
    ) -> None:
        """Prepares pushes.

        Args:
            obj: the object.
            pushes: any number of them.
            physics: with a regime other than "auto".
            approximate: whether `simulate` may take less time for poses that are off by up to 0.01
                mm and 0.005 degrees at the end of 10 cm (`docs/theory/model.md`, section 10).

        Raises:
            SimulationError: an object is not on its table, or the regime is "auto".
        """
        self.obj = obj
        self.physics = physics
        self.approximate = approximate
        self.offsets = np.append(0, np.cumsum([len(one.rows) for one in pushes], dtype=np.int64))
        near = [
            find_edges_near(obj, one.push, one.pose, one.table, physics.inertial) for one in pushes
        ]
        discs = [i for i, one in enumerate(pushes) if one.push.shape is None]
        self._shaped = [
            self._make_shaped(i, one, near[i])
            for i, one in enumerate(pushes)
            if one.push.shape is not None
        ]

        # One call of the kernel knows one table; pushes far from any edge go together.
        kinds = {i: None if (edges := near[i]) is None else edges.tobytes() for i in discs}
        self._groups = []
        for kind in dict.fromkeys(kinds.values()):
            chosen = np.array([i for i, one in kinds.items() if one == kind])
            self._groups.append(self._make_group(pushes, chosen, near[chosen[0]]))

    def __len__(self) -> int:
        """Number of pushes."""
        return len(self.offsets) - 1

    def simulate(self, params: CellParameters) -> tuple[Array, NDArray[np.bool_]]:
        """Simulates all pushes with some parameters.

        Returns:
            The wanted poses (R, 3), m and rad, push by push; and (P,) whether the pusher touched
            the object, a step was not solved or the object tips.
        """
        poses = np.empty((self.offsets[-1], 3))
        touched = np.empty(len(self), dtype=np.bool_)
        for group in self._groups:
            poses[group.rows], touched[group.chosen] = self._run(group, params, np.empty((0, 3, 0)))
        for one, steps, _ in self._run_shaped(params, differentiate=False):
            poses[one.rows] = steps.poses[one.wanted, 0]
            unsolved = (steps.statuses[:, 0] != STEP_CONVERGED).any()
            touched[one.place] = unsolved or steps.modes.any() or steps.tips.any()
        return poses, touched

    @property
    def near_edge(self) -> bool:
        """Whether any of the pushes may come over a table's edge."""
        tables = [group.table for group in self._groups] + [one.table for one in self._shaped]
        return any(table is not None for table in tables)

    def differentiate(
        self, params: CellParameters, along: Array | None = None
    ) -> tuple[Array, Array]:
        """Simulates all pushes, and differentiates the wanted poses.

        Args:
            params: the cells' parameters.
            along: (n, D) directions of log mu in which the frictions are changed, besides, with the
                loads mu_i m_i held; none by default. Away from a table's edge nothing depends on
                them.

        Returns:
            The poses (R, 3), m and rad, push by push, and their exact derivatives (R, 3, n+6+D).

        They are by the n masses, 1/kg, by the contact friction, by the place (x, y) where the push
        begins, 1/m, by the object's first pose (x, y, theta), and by the D changes of the
        frictions.
        """
        n = self.obj.n
        poses = np.empty((self.offsets[-1], 3))
        extra = 0 if along is None else along.shape[1]
        derivatives = np.zeros((self.offsets[-1], 3, n + 6 + extra))
        for group in self._groups:
            shifted = shifts_loads(params, group.table)
            changes = along if group.table is not None else None
            width = count_columns(n, shifted, with_friction=changes is not None)
            J = np.empty((len(group.rows), 3, width))
            poses[group.rows], _ = self._run(group, params, J)
            raw = RawJacobian.of_parameters(
                Bodies(self.obj, params, self.physics), steps=group.steps, J=J, shifted=shifted
            )
            by_mass = raw.calc_mass()
            derivatives[group.rows, :, :n] = by_mass
            derivatives[group.rows, :, n] = raw.other[..., CONTACT_FRICTION]
            derivatives[group.rows, :, n + 1 : n + 3] = raw.other[..., START_X : START_Y + 1]
            derivatives[group.rows, :, n + 3 : n + 6] = raw.other[..., POSE_X : POSE_THETA + 1]
            if changes is not None:
                # With mu_i m_i held, m_i changes as 1 / mu_i.
                held = raw.calc_friction() * params.friction - by_mass * params.mass
                derivatives[group.rows, :, n + 6 :] = held @ changes
        # of the kernel's columns the cells' loads, the contact friction and the start come first
        by_mass = params.friction * self.physics.gravity
        at = place_columns(Bodies(self.obj, params, self.physics), varied=False)
        for one, steps, J in self._run_shaped(params, differentiate=True, along=along):
            poses[one.rows] = steps.poses[one.wanted, 0]
            own = J[one.row_of_step[one.wanted], 0]
            shifted = shifts_loads(params, one.table)
            derivatives[one.rows, :, :n] = own[..., :n] if shifted else own[..., :n] * by_mass
            derivatives[one.rows, :, n : n + 3] = own[..., n : n + 3]
            derivatives[one.rows, :, n + 3 : n + 6] = own[..., at.pose : at.loads]
            if one.table is not None and along is not None:
                # With mu_i m_i held, m_i changes as 1 / mu_i.
                held = own[..., at.loads + 1 :] * params.friction - own[..., :n] * params.mass
                derivatives[one.rows, :, n + 6 :] = held @ along
        return poses, derivatives

    def _run_shaped(
        self, params: CellParameters, *, differentiate: bool, along: Array | None = None
    ) -> Iterator[tuple[_ShapedPush, SceneSteps, Array]]:
        """Simulates the pushes by other shapes; yields each with its steps and its J (R, 1, 3, w).

        Args:
            params: the cells' parameters.
            differentiate: whether the kernel's derivatives are wanted; w is 0 where not.
            along: as of `differentiate`.
        """
        if not self._shaped:
            return
        bodies = Bodies(self.obj, params, self.physics)
        check_shaped_push(bodies)
        arrays = make_bodies(bodies)
        for one in self._shaped:
            width = 0
            if differentiate:
                width = count_scene_columns(
                    bodies,
                    shifted=shifts_loads(params, one.table),
                    with_friction=along is not None and one.table is not None,
                )
            J = np.empty((len(one.rows), 1, 3, width))
            steps = run_scene_kernel(
                arrays,
                self.physics,
                pusher=one.path,
                state=make_scene_state(one.pose),
                contacts=make_scene_contacts(1, one.path.tool),
                dts=one.dts,
                row_of_step=one.row_of_step,
                J=J,
                support=make_support(bodies, one.table),
            )
            yield one, steps, J

    def _make_shaped(self, place: int, one: BatchPush, near: Array | None) -> _ShapedPush:
        """Prepares a push by a pusher that is no single disc; `near` is (K, 4) edges, or None."""
        wanted, first = np.unique(one.rows, return_index=True)
        row_of_step = np.full(len(one.times), -1)
        row_of_step[wanted] = first
        return _ShapedPush(
            place=place,
            path=make_pusher_path(one.push, one.times),
            pose=np.array([one.pose], dtype=np.float64),
            dts=measure_steps(one.push, one.times, self.physics.regime),
            wanted=one.rows,
            row_of_step=row_of_step,
            rows=np.arange(self.offsets[place], self.offsets[place + 1]),
            table=near,
        )

    def _run(
        self, group: _EdgeGroup, params: CellParameters, J: Array
    ) -> tuple[Array, NDArray[np.bool_]]:
        poses, touched = run_pushes(
            Bodies(self.obj, params, self.physics),
            pushes=group.pushes,
            row_of_step=group.row_of_step,
            J=J,
            rows=len(group.rows),
            table=group.table,
            approximate=self.approximate and not len(J),
        )
        # A pose that is wanted more than once is recorded once.
        if len(J):
            again = group.recorded != np.arange(len(J))
            J[again] = J[group.recorded[again]]
        return poses[group.recorded], touched

    def _make_group(
        self, pushes: Sequence[BatchPush], chosen: IntArray, table: Array | None
    ) -> _EdgeGroup:
        # Push p has the steps first[p] to first[p+1], and one more pose than steps.
        some = [pushes[i] for i in chosen]
        first = np.append(0, np.cumsum([len(one.times) - 1 for one in some], dtype=np.int64))
        row_of_step = np.full(int(first[-1]) + len(some), -1)
        wanted = np.concatenate([first[p] + p + one.rows for p, one in enumerate(some)])
        row_of_step[wanted] = np.arange(len(wanted))
        regime = self.physics.regime
        return _EdgeGroup(
            chosen=chosen,
            table=table,
            pushes=Pushes(
                first=first,
                dts=np.concatenate([measure_steps(one.push, one.times, regime) for one in some]),
                tips=np.concatenate([one.push.tip_at(one.times) for one in some]),
                path_lengths=np.array([one.push.length for one in some]),
                radii=np.array([one.push.radius for one in some]),
                poses=np.array([one.pose for one in some], dtype=np.float64),
            ),
            row_of_step=row_of_step,
            recorded=row_of_step[wanted],
            rows=np.concatenate([np.arange(self.offsets[i], self.offsets[i + 1]) for i in chosen]),
            steps=np.concatenate([one.rows for one in some]),
        )
