"""`GridLcpSystem`: a grid object under a pusher; `simulate` as a Drake system, step by step.

With q = (x, y, theta) the pose X_WB and nu = (vx, vy, w) the velocity of B's origin,

    (q, nu)[n+1] = step(q[n], nu[n]; m, mu, mu_c, h, patch; p_WP(t_n), v_WP(t_n), W(t_n))

with t_n = n dt the time of step n, and h the height at which the pusher acts.

At the beginning of a step the pusher is where its port says, and through the step it moves at the
velocity that the port says then. If its true motion bends within a step, the next step begins at
the true place again, so that no error adds up.
"""

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiscreteStateIndex,
    DiscreteValues,
    LeafSystem,
    ValueProducer,
)

from gridpush_drake.dynamics.kernel_call import run_kernel, shifts_loads
from gridpush_drake.dynamics.kernels.inputs import Load, Steps
from gridpush_drake.dynamics.kernels.step import STEP_CONVERGED
from gridpush_drake.dynamics.kernels.step_memory import MEMORY_SIZE, make_memory
from gridpush_drake.dynamics.motion import Jacobian, RawJacobian
from gridpush_drake.dynamics.physics import Regime, make_physics
from gridpush_drake.dynamics.push import DEFAULT_DT
from gridpush_drake.dynamics.pusher import DEFAULT_PUSHER_RADIUS
from gridpush_drake.dynamics.simulation import count_columns, get_edges
from gridpush_drake.errors import SimulationError
from gridpush_drake.geometry.se2 import Array, check_vector
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly
from gridpush_drake.objects.parameters import CellParameters

NO_PUSHER = -1.0
"""Radius of the pusher by which the kernel is told that there is no pusher, m."""

_STATE, _MEMORY, _CONTACT_FORCE, _UNSOLVED, _TIPPING = map(DiscreteStateIndex, range(5))


class GridLcpSystem(LeafSystem):
    """A grid object of n cells that is pushed, stepped every `dt` by the condensed LCP.

    .. pydrake_system::

        name: GridLcpSystem
        input_ports:
        - pusher_state
        - applied_wrench
        output_ports:
        - pose
        - velocity
        - cell_positions
        - contact_force
        - step_jacobian
        - unsolved_steps
        - tipping_steps

    * pusher_state: vector of 4, x and y of the disc's center p_WP, m, and its velocity v_WP, m/s.
      If it is not connected, or NaN, there is no pusher.
    * applied_wrench: vector of 3, force on B's origin in W, N, and moment, N m, constant during a
      step. If it is not connected, or not finite, there is no wrench. Only in the inertial regime.
    * pose: vector of 3, q = (x, y, theta) of B in W, m and rad.
    * velocity: vector of 3, (vx, vy, w) of B's origin in W, m/s and rad/s.
    * cell_positions: vector of 2n, x and y of every cell's center p_WC in turn, m.
    * contact_force: vector of 2, force of the pusher on the object in W during the last step, N.
    * step_jacobian: abstract `dynamics.motion.Jacobian` with one row: the derivatives of the pose
      at the end of the step that begins now by mass, friction, contact friction, pose, and the
      pusher's place (`start`), direction and path (`length`) during it, and by the push height
      where loads shift; the velocity at the beginning is held. Depends on the inputs directly. Not
      with a friction law that has no exact gradients (a SimulationError).
    * unsolved_steps: vector of 1, number of steps that the solver did not solve to its tolerance.
      As in `simulate`, the motion goes on from what the solver had.
    * tipping_steps: vector of 1, number of steps in which no loads could hold the object: it tips,
      or falls off the table.

    * Discrete state: (q, nu); the solver's memory (`dynamics.kernels.step_memory`); the last
      contact force; the unsolved steps; the tipping steps.
    * Numeric parameters: mass (n), kg; friction (n); contact friction (1); push height (1), m;
      patch ratio (1); see `CellParameters`.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        model: Model,
        dt: float = DEFAULT_DT,
        regime: Regime | None = None,
        pusher_radius: float | None = None,
        *,
        pose: ArrayLike = (0.0, 0.0, 0.0),
        velocity: ArrayLike = (0.0, 0.0, 0.0),
        table: ArrayLike | None = None,
    ) -> None:
        """Declares the system.

        Args:
            model: one object, with its parameters and physics.
            dt: step, s. At 0.01 s a pusher of 0.1 m/s moves 1 mm a step.
            regime: takes the place of the one in `physics`. "auto", the default, is "inertial"
                here, which holds at every speed: how fast the pusher will go is not known.
            pusher_radius: of the disc, m; by default the prior's, or DEFAULT_PUSHER_RADIUS.
            pose: (3,) at the beginning, m and rad.
            velocity: (3,) at the beginning, m/s and rad/s.
            table: (K, 2) corners in W of the table's top, m, see `simulate`; endless by default.

        Raises:
            SimulationError: an argument is out of range.
            ParameterError: `params` belongs to another object.
        """
        obj = model.obj
        params = model.params
        physics = model.physics
        super().__init__()
        if not (np.isfinite(dt) and dt > 0):
            raise SimulationError(f"dt is {dt!r}; expected a positive number (s)")
        used = make_physics(physics, regime)
        if used.regime == "auto":
            used = used.with_regime("inertial")
        radius = (
            obj.prior.pusher_radius or DEFAULT_PUSHER_RADIUS
            if pusher_radius is None
            else pusher_radius
        )
        if not (np.isfinite(radius) and radius > 0):
            raise SimulationError(f"pusher_radius is {radius!r}; expected a positive number (m)")
        params = CellParameters.uniform(obj) if params is None else params
        params.center_of_mass(obj)
        self.obj = obj
        self.dt = float(dt)
        self.pusher_radius = radius
        self.physics = used
        self._table = None if table is None else get_edges(table)
        self._declare_state(params, _check_state(pose, velocity))
        self._pusher_state = self.DeclareVectorInputPort("pusher_state", 4)
        self._wrench = self.DeclareVectorInputPort("applied_wrench", 3) if used.inertial else None
        self._declare_outputs()
        self.DeclarePeriodicDiscreteUpdateEvent(self.dt, 0.0, self._step)

    def SetPose(
        self, context: Context, pose: ArrayLike, velocity: ArrayLike = (0.0, 0.0, 0.0)
    ) -> None:
        """Places the object: pose (3,) m and rad, velocity (3,) m/s and rad/s.

        Raises:
            SimulationError: they are not finite numbers.
        """
        state = _check_state(pose, velocity)
        context.SetDiscreteState(_STATE, state)
        context.SetDiscreteState(_MEMORY, make_memory())
        context.SetDiscreteState(_CONTACT_FORCE, np.zeros(2))
        context.SetDiscreteState(_UNSOLVED, np.zeros(1))
        context.SetDiscreteState(_TIPPING, np.zeros(1))

    def SetParameters(self, context: Context, params: CellParameters) -> None:
        """Gives this Context parameters of its own.

        Raises:
            ParameterError: they belong to another object.
        """
        params.center_of_mass(self.obj)
        for index, value in enumerate(_list_values(params)):
            context.get_mutable_numeric_parameter(index).SetFromVector(value)

    def GetParameters(self, context: Context) -> CellParameters:
        """Returns the parameters in a Context."""
        count = context.num_numeric_parameter_groups()
        mass, friction, *numbers = (
            context.get_numeric_parameter(i).CopyToVector() for i in range(count)
        )
        return CellParameters(mass, friction, *(float(number[0]) for number in numbers))

    def _declare_state(self, params: CellParameters, state: Array) -> None:
        for value in _list_values(params):
            self.DeclareNumericParameter(BasicVector(value))
        self.DeclareDiscreteState(state)
        self.DeclareDiscreteState(MEMORY_SIZE)
        self.DeclareDiscreteState(2)
        self.DeclareDiscreteState(1)
        self.DeclareDiscreteState(1)
        # Checking and copying n masses at every step would cost as much as the step: they are
        # cached. The entry is kept by its index, for the entry itself would hold the system where
        # Python's garbage collector does not see it.
        self._params = self.DeclareCacheEntry(
            description="cell parameters",
            value_producer=ValueProducer(
                allocate=lambda: AbstractValue.Make(params),
                calc=weakly(self._calc_params),
            ),
            prerequisites_of_calc={self.all_parameters_ticket()},
        ).cache_index()

    def _declare_outputs(self) -> None:
        state = {self.discrete_state_ticket(_STATE)}
        self.DeclareVectorOutputPort("pose", 3, weakly(self._calc_pose), state)
        self.DeclareVectorOutputPort("velocity", 3, weakly(self._calc_velocity), state)
        self.DeclareVectorOutputPort(
            "cell_positions", 2 * self.obj.n, weakly(self._calc_cell_positions), state
        )
        self.DeclareStateOutputPort("contact_force", _CONTACT_FORCE)
        inputs = {self.all_input_ports_ticket(), self.all_parameters_ticket(), self.xd_ticket()}
        none = _make_zero_jacobian(self.obj.n)
        self.DeclareAbstractOutputPort(
            "step_jacobian",
            lambda: AbstractValue.Make(none),
            weakly(self._calc_step_jacobian),
            inputs,
        )
        self.DeclareStateOutputPort("unsolved_steps", _UNSOLVED)
        self.DeclareStateOutputPort("tipping_steps", _TIPPING)

    def _calc_params(self, context: Context, value: AbstractValue) -> None:
        value.set_value(self.GetParameters(context))

    def _calc_pose(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state(_STATE).value()[:3])

    def _calc_velocity(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state(_STATE).value()[3:])

    def _calc_cell_positions(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(
            self.obj.cells_at(context.get_discrete_state(_STATE).value()[:3]).ravel()
        )

    def _calc_step_jacobian(self, context: Context, output: BasicVector) -> None:
        if True not in self.physics.law.gradients:
            raise SimulationError(
                f"step_jacobian: friction_law {self.physics.friction_law!r} has no exact gradients"
            )
        params: CellParameters = self.get_cache_entry(self._params).Eval(context)
        shifted = shifts_loads(params, self._table)
        J = np.empty((1, 3, count_columns(self.obj.n, shifted, with_friction=True)))
        self._run(context, context.get_discrete_state(_MEMORY).CopyToVector(), J)
        raw = RawJacobian.of_parameters(
            Model(self.obj, params, self.physics), steps=np.array([1]), J=J, shifted=shifted
        )
        output.set_value(raw.expand())

    def _step(self, context: Context, next_state: DiscreteValues) -> None:
        memory = context.get_discrete_state(_MEMORY).CopyToVector()
        record = self._run(context, memory, np.empty((0, 3, 0)))
        next_state.set_value(_STATE, np.concatenate([record.poses[1], record.velocities[1]]))
        next_state.set_value(_MEMORY, memory)
        next_state.set_value(_CONTACT_FORCE, record.contact_forces[0].sum(axis=0))
        unsolved = context.get_discrete_state(_UNSOLVED).value() + (
            record.statuses[0, 0] != STEP_CONVERGED
        )
        next_state.set_value(_UNSOLVED, unsolved)
        next_state.set_value(
            _TIPPING, context.get_discrete_state(_TIPPING).value() + record.tips[0]
        )

    def _run(self, context: Context, memory: Array, J: Array) -> Steps:
        """Takes one step from the state in a Context.

        Args:
            context: the Context.
            memory: the solver's memory, which is updated.
            J: (1, 3, C) to be filled with the step's derivatives, or (0, 3, 0) for none.
        """
        state = context.get_discrete_state(_STATE).CopyToVector()
        row_of_step = np.array([-1, 0 if len(J) else -1])
        return run_kernel(
            Model(self.obj, self.get_cache_entry(self._params).Eval(context), self.physics),
            pose=state[:3],
            velocity=state[3:],
            dts=np.array([self.dt]),
            load=self._calc_load(context),
            row_of_step=row_of_step,
            J=J,
            memory=memory,
            table=self._table,
        )

    def _calc_load(self, context: Context) -> Load:
        """Reads what drives the object in the step that begins now."""
        wrench = np.zeros((1, 3))
        if self._wrench is not None and self._wrench.HasValue(context):
            wrench[0] = self._wrench.Eval(context)
            wrench[~np.isfinite(wrench).all(axis=1)] = 0.0
        pusher = np.full(4, np.nan)
        if self._pusher_state.HasValue(context):
            pusher = self._pusher_state.Eval(context)
        if not np.isfinite(pusher).all():
            return Load(
                tip=np.zeros((2, 2)),
                path_length=0.0,
                radius=NO_PUSHER,
                wrench=wrench,
                point=np.zeros(2),
            )
        path = pusher[2:] * self.dt
        return Load(
            tip=np.array([pusher[:2], pusher[:2] + path]),
            path_length=float(np.hypot(*path)),
            radius=self.pusher_radius,
            wrench=wrench,
            point=np.zeros(2),
        )


def _list_values(params: CellParameters) -> list[Array]:
    """Lists the values of the numeric parameters, in the order of `CellParameters`."""
    numbers = (params.contact_friction, params.push_height, params.patch_ratio)
    return [params.mass, params.friction, *(np.array([number]) for number in numbers)]


def _make_zero_jacobian(n: int) -> Jacobian:
    """Makes a Jacobian of one row of zeros for n cells, which tells Drake the type of the port."""
    zeros = np.zeros((1, 3))
    by_cell = np.zeros((1, 3, n))
    return Jacobian(
        steps=np.array([1]),
        mass=by_cell,
        friction=by_cell,
        contact_friction=zeros,
        start=np.zeros((1, 3, 2)),
        direction=zeros,
        length=zeros,
        pose=np.zeros((1, 3, 3)),
    )


def _check_state(pose: ArrayLike, velocity: ArrayLike) -> Array:
    """Checks a pose and a velocity, (3,) each; returns them in one vector (6,)."""
    both = (("pose", pose), ("velocity", velocity))
    return np.concatenate([check_vector(SimulationError, name, value, 3) for name, value in both])
