"""`GridLcpStep_`: a pushed grid object as a difference equation, for numbers and for `AutoDiffXd`.

With q = (x, y, theta) the pose X_WB, u = (p_WP, v_WP) the pusher's place and velocity when a step
begins, and p the cells' parameters,

    q[n+1] = f(q[n], u[n]; p)

in the quasi-static regime. The pose is all the state there is: unlike `GridLcpSystem`, it remembers
neither the velocity, by which that system predicts where a body will be halfway through a step, nor
where its solver was. So it is a little less accurate at the same step, and it is what Drake's tools
for discrete systems ask for: `FirstOrderTaylorApproximation`, `DirectTranscription`,
`ToAutoDiffXd`. Their derivatives are the exact ones of the kernel.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.systems.framework import BasicVector_, LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from gridpush_drake.dynamics.kernel_call import run_kernel, shifts_loads
from gridpush_drake.dynamics.kernels.inputs import Load
from gridpush_drake.dynamics.motion import RawJacobian
from gridpush_drake.dynamics.physics import Physics, make_physics
from gridpush_drake.dynamics.push import DEFAULT_DT
from gridpush_drake.dynamics.pusher import DEFAULT_PUSHER_RADIUS
from gridpush_drake.dynamics.simulation import count_columns, get_edges
from gridpush_drake.errors import SimulationError
from gridpush_drake.geometry.se2 import Array, check_vector
from gridpush_drake.identification.model import Model
from gridpush_drake.interop.differentiable import calc_velocity_block
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

POSE_SIZE = 3
"""Numbers of a pose in the plane."""


class PushStep:
    """The difference equation on plain arrays, and its derivatives.

    Attributes:
        obj: the object.
        dt: the step, s.
        radius: of the pusher, m.
        physics: quasi-static.
    """

    def __init__(
        self,
        obj: GridObject,
        dt: float = DEFAULT_DT,
        pusher_radius: float | None = None,
        physics: Physics | None = None,
        table: ArrayLike | None = None,
    ) -> None:
        """Makes the equation; see `GridLcpStep_` for the arguments."""
        if not (np.isfinite(dt) and dt > 0):
            raise SimulationError(f"dt is {dt!r}; expected a positive number (s)")
        used = make_physics(physics, None)
        if used.regime == "auto":
            used = used.with_regime("quasi_static")
        if used.inertial or True not in used.law.gradients:
            raise SimulationError(
                f"physics: a step without memory is quasi-static and has exact gradients; regime "
                f"is {used.regime!r} and friction_law {used.friction_law!r}"
            )
        radius = obj.prior.pusher_radius if pusher_radius is None else pusher_radius
        self.radius = DEFAULT_PUSHER_RADIUS if radius is None else float(radius)
        if not (np.isfinite(self.radius) and self.radius > 0):
            raise SimulationError(
                f"pusher_radius is {pusher_radius!r}; expected a positive number (m)"
            )
        self.obj = obj
        self.dt = float(dt)
        self.physics = used
        self._table = None if table is None else get_edges(table)

    def calc_next(self, q: Array, u: Array, params: CellParameters) -> Array:
        """Calculates the pose (3,) after a step from q (3,) with a pusher u (4,), if any."""
        return self._run(q, u, params, np.empty((0, POSE_SIZE, 0)))

    def differentiate(
        self, q: Array, u: Array, params: CellParameters
    ) -> tuple[Array, dict[str, Array]]:
        """The pose after a step, and its derivatives.

        A pusher at rest has no direction: by its velocity the derivative is then taken as zero.

        Returns:
            The pose (3,); and by "pose" (3, 3), "pusher" (3, 4), "mass" (3, n), "friction" (3, n),
            "contact_friction" (3, 1) and "push_height" (3, 1).
        """
        n = self.obj.n
        shifted = shifts_loads(params, self._table)
        J = np.empty((1, POSE_SIZE, count_columns(n, shifted, with_friction=True)))
        after = self._run(q, u, params, J)
        blocks = {
            "pose": np.eye(POSE_SIZE),
            "pusher": np.zeros((POSE_SIZE, 4)),
            "mass": np.zeros((POSE_SIZE, n)),
            "friction": np.zeros((POSE_SIZE, n)),
            "contact_friction": np.zeros((POSE_SIZE, 1)),
            "push_height": np.zeros((POSE_SIZE, 1)),
        }
        if not np.isfinite(u).all():
            return after, blocks
        found = RawJacobian(
            steps=np.array([1]),
            J=J,
            p_BC=self.obj.p_BC,
            cell_size=self.obj.cell_size,
            mass=params.mass,
            friction=params.friction,
            gravity=self.physics.gravity,
            inertial=False,
            start_tangent=None,
            shifted=shifted,
        ).expand()
        blocks["pose"] = found.pose[0]
        blocks["mass"] = found.mass[0]
        blocks["friction"] = found.friction[0]
        blocks["contact_friction"] = found.contact_friction[0][:, None]
        blocks["pusher"][:, :2] = found.start[0]
        if u[2:].any():
            blocks["pusher"][:, 2:] = calc_velocity_block(found, u[2:], self.dt)[0]
        if found.push_height is not None:
            blocks["push_height"] = found.push_height[0][:, None]
        return after, blocks

    def _run(self, q: Array, u: Array, params: CellParameters, J: Array) -> Array:
        """Takes a step; J (1 or 0 rows) is filled."""
        if not np.isfinite(u).all():
            return q.copy()
        path = u[2:] * self.dt
        load = Load(
            tip=np.array([u[:2], u[:2] + path]),
            path_length=float(np.hypot(*path)),
            radius=self.radius,
            wrench=np.zeros((1, POSE_SIZE)),
            point=np.zeros(2),
        )
        record = run_kernel(
            Model(self.obj, params, self.physics),
            pose=q,
            velocity=np.zeros(POSE_SIZE),
            dts=np.array([self.dt]),
            load=load,
            row_of_step=np.array([-1, 0 if len(J) else -1]),
            J=J,
            table=self._table,
        )
        return np.asarray(record.poses[1])


PARAMETER_NAMES = ("mass", "friction", "contact_friction", "push_height", "patch_ratio")
"""The numeric parameters in their order, which is that of `CellParameters`."""


@TemplateSystem.define("GridLcpStep_", T_list=[float, AutoDiffXd])
def GridLcpStep_(T: Any) -> Any:
    """The class of a scalar type."""
    differentiates = T is AutoDiffXd

    class Impl(LeafSystem_[T]):
        """A pushed grid object as a difference equation, q[n+1] = f(q[n], u[n]; p).

        .. pydrake_system::

            name: GridLcpStep_
            input_ports:
            - pusher_state
            output_ports:
            - pose

        * pusher_state: vector of 4, (x, y) of the disc's center p_WP in m and its velocity v_WP in
          m/s, in W, when the step begins. Not connected, or NaN in it: there is no pusher.
        * pose: vector of 3, q = (x, y, theta) of B in W, m and rad.

        * Discrete state: q, in one group.
        * Numeric parameters: mass (n), kg; friction (n); contact friction (1); push height (1), m;
          patch ratio (1), which is held where derivatives are taken; see `CellParameters`.
        """

        __slots__ = NO_SLOTS

        def _construct(
            self,
            model: Model,
            dt: float = DEFAULT_DT,
            *,
            pusher_radius: float | None = None,
            table: ArrayLike | None = None,
            pose: ArrayLike = (0.0, 0.0, 0.0),
            converter: Any = None,
        ) -> None:
            """Declares the system.

            Args:
                model: one object, with its parameters and physics.
                dt: step, s.
                pusher_radius: of the disc, m; by default the prior's, or DEFAULT_PUSHER_RADIUS.
                table: (K, 2) corners in W of the table's top, m; endless by default.
                pose: (3,) at the beginning, m and rad.
                converter: Drake's, between scalar types.

            Raises:
                SimulationError: an argument is out of range, the regime is "inertial", or the
                    friction law has no exact gradients.
                ParameterError: `params` belongs to another object.
            """
            obj = model.obj
            params = model.params
            used = CellParameters.uniform(obj) if params is None else params
            used.center_of_mass(obj)
            step = PushStep(obj, dt, pusher_radius, model.physics, table)
            start = check_vector(SimulationError, "pose", pose, POSE_SIZE)
            self._declare(step, used, start, converter)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            self._declare(other.step, other.params, other.start, converter)

        def _declare(
            self, step: PushStep, params: CellParameters, start: Array, converter: Any
        ) -> None:
            LeafSystem_[T].__init__(self, converter=converter)
            self.step = step
            self.params = params
            self.start = start
            for name in PARAMETER_NAMES:
                values = np.atleast_1d(getattr(params, name))
                self.DeclareNumericParameter(BasicVector_[T](values.tolist()))
            self._pusher = self.DeclareVectorInputPort("pusher_state", 4)
            state = self.DeclareDiscreteState(start.tolist())
            self.DeclareStateOutputPort("pose", state)
            self.DeclarePeriodicDiscreteUpdateEvent(step.dt, 0.0, self._advance)

        def SetPose(self, context: Any, pose: ArrayLike) -> None:
            """Places the object: pose (3,), m and rad.

            Raises:
                SimulationError: they are not finite numbers.
            """
            context.SetDiscreteState(check_vector(SimulationError, "pose", pose, POSE_SIZE))

        def _advance(self, context: Any, next_state: Any) -> None:
            u = np.full(4, np.nan)
            if self._pusher.HasValue(context):
                u = self._pusher.Eval(context)
            q = context.get_discrete_state_vector().CopyToVector()
            values = [
                context.get_numeric_parameter(i).CopyToVector() for i in range(len(PARAMETER_NAMES))
            ]
            advance = _advance_with_derivatives if differentiates else _advance_numbers
            next_state.set_value(advance(self.step, q, u, values))

    return Impl


GridLcpStep = GridLcpStep_[float]
"""The system on plain numbers."""


def _advance_numbers(step: PushStep, q: Array, u: Array, values: list[Array]) -> Array:
    return step.calc_next(q, u, _make_parameters(values))


def _advance_with_derivatives(step: PushStep, q: Any, u: Any, values: list[Any]) -> Any:
    """The pose as AutoDiffXd: derivatives of all that goes in, times those of the step."""
    plain = _make_parameters([_find_value(value) for value in values])
    after, blocks = step.differentiate(_find_value(q), _find_value(u), plain)
    inputs = {"pose": q, "pusher": u, **dict(zip(PARAMETER_NAMES, values, strict=True))}
    gradients = {name: _find_gradient(inputs[name]) for name in blocks}
    width = max(gradient.shape[1] for gradient in gradients.values())
    total = np.zeros((POSE_SIZE, width))
    for name, block in blocks.items():
        gradient = gradients[name]
        if gradient.shape[1]:
            total += block @ gradient
    return InitializeAutoDiff(after, total).ravel() if width else after


def _make_parameters(values: list[Array]) -> CellParameters:
    mass, friction, *numbers = values
    return CellParameters(mass, friction, *(float(number[0]) for number in numbers))


def _find_value(vector: Any) -> Array:
    if vector.dtype != object:
        return np.asarray(vector, dtype=np.float64)
    return np.asarray(ExtractValue(vector)).ravel()


def _find_gradient(vector: Any) -> Array:
    """Derivatives (k, m) of k numbers; (k, 0) where there are none."""
    if vector.dtype != object:
        return np.zeros((len(vector), 0))
    return np.asarray(ExtractGradient(vector))
