"""`GridSceneSystem`: several grid objects under a pusher, as a Drake system.

With q the poses X_WB of all N bodies and xi their twists in the last step,

    (q, xi)[n+1] = step(q[n], xi[n]; p_WP(t_n), v_WP(t_n))

with t_n = n dt the time of step n. At the beginning of a step the pusher is where its port says,
and through the step it moves at the velocity that the port says then.
"""

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiscreteStateIndex,
    DiscreteValues,
    LeafSystem,
)

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.kernels.scene.records import (
    IDENTITY_SIZE,
    BodyStates,
    Contacts,
    PusherPath,
)
from gridpush_drake.dynamics.kernels.step import STEP_CONVERGED
from gridpush_drake.dynamics.push import DEFAULT_DT
from gridpush_drake.dynamics.pusher import DEFAULT_PUSHER_RADIUS, PusherShape
from gridpush_drake.dynamics.scene.cores import check_overlap
from gridpush_drake.dynamics.scene.kernel_call import (
    make_bodies,
    make_scene_contacts,
    make_scene_state,
    make_tool,
    run_scene_kernel,
)
from gridpush_drake.dynamics.scene.simulation import check_together
from gridpush_drake.errors import SimulationError, require_positive
from gridpush_drake.geometry.se2 import Array, check_vector
from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly

_POSES, _MEMORY, _CONTACTS, _FORCE, _UNSOLVED = map(DiscreteStateIndex, range(5))

_MOTION = 7
"""Numbers that the memory holds of each body: the twists of the last two steps, and how many steps
it has moved in a row."""


class GridSceneSystem(LeafSystem):
    """N grid objects that are pushed and push each other, stepped every `dt`, quasi-statically.

    .. pydrake_system::

        name: GridSceneSystem
        input_ports:
        - pusher_state
        output_ports:
        - pose_0
        - pose_1
        - poses
        - contact_force
        - unsolved_steps

    * pusher_state: vector of 4, x and y of the disc's center p_WP, m, and its velocity v_WP, m/s.
      If it is not connected, or NaN, there is no pusher, and nothing moves.
    * pose_0, pose_1, ...: vector of 3 each, q = (x, y, theta) of each body in W, m and rad; as many
      ports as there are bodies, in the order of the objects.
    * poses: vector of 3N, all of them in turn.
    * contact_force: vector of 2, force of the pusher on all bodies together in W during the last
      step, N.
    * unsolved_steps: vector of 1, number of steps that the solver did not solve to its tolerance.
      As in `simulate`, the motion goes on from what the solver had.

    * Discrete state: the poses; the solver's memory of motion and of contacts; the last contact
      force; the unsolved steps.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        bodies: Bodies,
        poses: ArrayLike,
        dt: float = DEFAULT_DT,
        pusher_radius: float = DEFAULT_PUSHER_RADIUS,
    ) -> None:
        """Declares the system.

        Args:
            bodies: the objects, with their parameters and physics.
            poses: (N, 3) where they lie at the beginning, X_WB, m and rad.
            dt: step, s. At 0.01 s a pusher of 0.1 m/s moves 1 mm a step.
            pusher_radius: of the disc, m.

        Raises:
            SimulationError: an argument is out of range, or something is asked for that scenes do
                not support.
        """
        super().__init__()
        require_positive(SimulationError, unit="s", dt=dt)
        require_positive(SimulationError, unit="m", pusher_radius=pusher_radius)
        self.bodies = check_together(bodies)
        self.dt = float(dt)
        self.pusher_radius = float(pusher_radius)
        self._bodies = make_bodies(self.bodies)
        n = len(bodies)
        self._room = len(make_scene_contacts(n).modes)
        self.DeclareDiscreteState(self._check_poses(poses))
        self.DeclareDiscreteState(_MOTION * n)
        # a row for each contact of the last step, identity and mode; and their number at the end
        self.DeclareDiscreteState((IDENTITY_SIZE + 1) * self._room + 1)
        self.DeclareDiscreteState(2)
        self.DeclareDiscreteState(1)
        self._pusher_state = self.DeclareVectorInputPort("pusher_state", 4)
        state = {self.discrete_state_ticket(_POSES)}
        for b in range(n):
            self.DeclareVectorOutputPort(f"pose_{b}", 3, weakly(self._calc_pose, b), state)
        self.DeclareStateOutputPort("poses", _POSES)
        self.DeclareStateOutputPort("contact_force", _FORCE)
        self.DeclareStateOutputPort("unsolved_steps", _UNSOLVED)
        self.DeclarePeriodicDiscreteUpdateEvent(self.dt, 0.0, self._step)

    def SetPoses(self, context: Context, poses: ArrayLike) -> None:
        """Places the objects at rest at poses (N, 3), m and rad.

        Raises:
            SimulationError: they are not N poses of finite numbers, or two objects overlap.
        """
        context.SetDiscreteState(_POSES, self._check_poses(poses))
        for index in (_MEMORY, _CONTACTS, _FORCE, _UNSOLVED):
            size = context.get_discrete_state(index).size()
            context.SetDiscreteState(index, np.zeros(size))

    def _check_poses(self, poses: ArrayLike) -> Array:
        """Makes poses (N, 3) of objects that do not overlap a vector (3 N,)."""
        n = len(self.bodies)
        given = np.asarray(poses, dtype=np.float64)
        if given.shape != (n, 3):
            raise SimulationError(f"poses of shape {given.shape}; expected ({n}, 3)")
        q = check_vector(SimulationError, "poses", given.ravel(), 3 * n)
        check_overlap(self.bodies.objects, q.reshape(n, 3))
        return q

    def _calc_pose(self, context: Context, output: BasicVector, body: int) -> None:
        poses = context.get_discrete_state(_POSES).value()
        output.SetFromVector(poses[3 * body : 3 * body + 3])

    def _step(self, context: Context, next_state: DiscreteValues) -> None:
        state = self._read_state(context)
        contacts = self._read_contacts(context)
        pusher = np.full(4, np.nan)
        if self._pusher_state.HasValue(context):
            pusher = self._pusher_state.Eval(context)
        if not np.isfinite(pusher).all():
            # without a pusher nothing moves, and nothing is remembered
            next_state.set_value(_POSES, state.q.ravel())
            for index in (_MEMORY, _CONTACTS, _FORCE):
                size = context.get_discrete_state(index).size()
                next_state.set_value(index, np.zeros(size))
            return
        path = pusher[2:] * self.dt
        n = len(self.bodies)
        record = run_scene_kernel(
            self._bodies,
            self.bodies.physics,
            pusher=PusherPath(
                tip=np.array([pusher[:2], pusher[:2] + path]),
                yaw=np.zeros(2),
                path_length=float(np.hypot(*path)),
                tool=make_tool(PusherShape.disc(self.pusher_radius)),
                variations=np.empty((0, 2, 3)),
            ),
            state=state,
            contacts=contacts,
            dts=np.array([self.dt]),
            row_of_step=np.full(2, -1),
            J=np.empty((0, n, 3, 0)),
        )
        by_finger = record.ids[0, : record.counts[0], 1] < 0
        force = record.forces[0, : record.counts[0]][by_finger].sum(axis=0)
        unsolved = context.get_discrete_state(_UNSOLVED).value() + (
            record.statuses[0, 0] != STEP_CONVERGED
        )
        memory = np.concatenate([state.twist.ravel(), state.before.ravel(), state.moved])
        rows = np.column_stack([contacts.ids, contacts.modes])
        next_state.set_value(_POSES, state.q.ravel())
        next_state.set_value(_MEMORY, memory)
        next_state.set_value(_CONTACTS, np.append(rows.ravel(), contacts.counts[0]))
        next_state.set_value(_FORCE, force)
        next_state.set_value(_UNSOLVED, unsolved)

    def _read_state(self, context: Context) -> BodyStates:
        """Reads poses and memory of motion from a Context."""
        n = len(self.bodies)
        state = make_scene_state(_get(context, _POSES).reshape(n, 3))
        twist, before, moved = np.split(_get(context, _MEMORY), [3 * n, 6 * n])
        state.twist[:] = twist.reshape(n, 3)
        state.before[:] = before.reshape(n, 3)
        state.moved[:] = moved
        return state

    def _read_contacts(self, context: Context) -> Contacts:
        """Reads the contacts of the last step from a Context."""
        contacts = make_scene_contacts(len(self.bodies))
        values = _get(context, _CONTACTS)
        rows = values[:-1].reshape(self._room, IDENTITY_SIZE + 1)
        contacts.ids[:] = rows[:, :IDENTITY_SIZE]
        contacts.modes[:] = rows[:, IDENTITY_SIZE]
        contacts.counts[0] = int(values[-1])
        return contacts


def _get(context: Context, index: DiscreteStateIndex) -> Array:
    """Copies a group of the discrete state."""
    copy: Array = context.get_discrete_state(index).CopyToVector()
    return copy
