"""NaN at random times in every input of every system: nothing is raised, and outputs say what is wrong."""

import numpy as np
import pytest
from pydrake.common.value import AbstractValue, Value
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import PortDataType

from gridpush_drake.dynamics.pusher import Pusher
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.tool_motion import make_transform
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.trial import ContactOptions
from gridpush_drake.planning.exploration import RandomPokes
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.systems.base.messages import GraspCommand, GraspOutcome, GraspPhase, PushCommand
from gridpush_drake.systems.control.contact_point_controller import ContactPointController
from gridpush_drake.systems.control.poke_policy import PokePolicy
from gridpush_drake.systems.control.pregrasp_controller import PreGraspController
from gridpush_drake.systems.dynamics.grid_lcp_system import GridLcpSystem
from gridpush_drake.systems.execution.grasp_executor import GraspExecutor
from gridpush_drake.systems.execution.press_executor import PressExecutor
from gridpush_drake.systems.execution.push_executor import PushExecutor
from gridpush_drake.systems.learning.estimate_visualizer import EstimateVisualizer, ShownObject
from gridpush_drake.systems.learning.grid_identifier import GridIdentifier
from gridpush_drake.systems.sensing.lift_scale import LiftScale
from gridpush_drake.systems.sensing.planar_pose_sensor import PlanarPoseSensor
from gridpush_drake.systems.sensing.pusher_gate import PusherGate
from gridpush_drake.systems.sensing.pusher_state_sensor import PusherStateSensor
from tests.helpers.made_identifications import make_block
from tests.helpers.poke_diagram import FINGER_RULES, REGION, make_poke_diagram
from tests.helpers.scene_cases import PLATE

OBJ = make_block(12)
TABLE = SupportSurface.rectangle((0.0, 0.0), (1.0, 1.0))
RULES = GoalRules(
    PushConstraints(TABLE), ContactOptions(Pusher(speed=0.1, clearance=0.005), (0.008, 0.3))
)
POSE = np.array([0.01, 0.02, 0.3])
PUSH = np.array([0.3, 0.0, np.pi, 0.05, 0.05])
GRASP = np.array([0.5, 0.0, 0.015, np.pi, 0.1])
PRESS = np.array([*OBJ.outline.centroid.coords[0], -0.02, 0.0, 0.0, 0.03, 0.0, 0.0, 0.0, 0.5])
COMMANDS = {"push_command": PUSH, "grasp_command": GRASP, "press_command": PRESS}
OPEN_GRIPPER = np.array([-0.05, 0.05, 0.0, 0.0])
UNIFORM = CellParameters.uniform(OBJ)
STEPS, STEP, FRACTION = 60, 0.11, 0.4
"""How often the inputs change, after how many s, and the fraction of them with NaN."""

LONG = 18.0
"""s, in which two pokes are made."""

GOOD = {
    "object_pose": POSE,
    "predicted_poses": POSE + 0.05,
    "goal_pose": np.array([0.15, 0.1, 1.0]),
    "pusher_state": np.array([0.08, 0.0, 0.01, -0.05, 0.0, 0.0]),
    "pusher_yaw": np.array([0.3]),
    "applied_wrench": np.array([0.1, 0.0, 0.01]),
    "mass": UNIFORM.mass,
    "friction": UNIFORM.friction,
    "contact_friction": np.array([0.4]),
    "center_of_mass": np.zeros(2),
    "center_of_mass_covariance": 1e-4 * np.eye(2).ravel(),
    "gripper_state": OPEN_GRIPPER,
    "force": np.array([0.3, -0.2, 1.0]),
    "grasp_wrench": np.array([0.1, 0.0, 0.0, 0.0, 0.0, -5.0]),
    "other_tip_pose": make_transform((0.5, 0.0, 0.2, 0.0)),
    "push_tip_pose": make_transform((0.5, 0.0, 0.2, 0.0)),
    "body_poses": [RigidTransform(), RigidTransform([0.1, 0.0, 0.0])],
    "body_spatial_velocities": [SpatialVelocity.Zero(), SpatialVelocity.Zero()],
}
"""What the ports show on good days, by name; others keep their default message."""

SYSTEMS = {
    "lcp": lambda: GridLcpSystem(Model(OBJ)),
    "identifier": lambda: GridIdentifier(OBJ),
    "identifier_of_a_shape": lambda: GridIdentifier(OBJ, pusher_shape=PLATE),
    "policy": lambda: PokePolicy(Model(OBJ), RandomPokes(region=REGION), FINGER_RULES),
    "contact_point": lambda: ContactPointController(Model(OBJ), RULES),
    "pre_grasp": lambda: PreGraspController(
        PreGraspPlanner(OBJ, TABLE), lambda pose, aim, masses, at_worst: None
    ),
    "push": lambda: PushExecutor((0.5, 0.0, 0.2), OBJ.outline),
    "grasp": GraspExecutor,
    "press": lambda: PressExecutor(OBJ),
    "lift": LiftScale,
    "camera": lambda: PlanarPoseSensor(BodyIndex(1)),
    "tip": lambda: PusherStateSensor(BodyIndex(1)),
    "gate": PusherGate,
}


def spoil(value, rng):
    """A value with NaN in it, where it is made of numbers."""
    if isinstance(value, np.ndarray):
        return np.where(rng.random(value.shape) < rng.uniform(), np.nan, value)
    if isinstance(value, RigidTransform):
        return RigidTransform(value.rotation(), spoil(value.translation(), rng))
    if isinstance(value, SpatialVelocity):
        return SpatialVelocity(spoil(value.rotational(), rng), spoil(value.translational(), rng))
    return [spoil(one, rng) for one in value] if isinstance(value, list) else value


def fix(system, context, name, value):
    if isinstance(value, list):
        value = Value[list[type(value[0])]](value)
    elif isinstance(value, RigidTransform):
        value = AbstractValue.Make(value)
    system.GetInputPort(name).FixValue(context, value)


def find_good(port, count):
    """What a port shows on a good day; a new command at every tenth count."""
    name, number = port.get_name(), 1 + count // 10
    if name.endswith("_command"):
        return np.concatenate([[number], COMMANDS[name]])
    return (
        GOOD[name][: port.size()]
        if port.get_data_type() == PortDataType.kVectorValued
        else GOOD.get(name)
    )


def simulate(system, seed):
    rng = np.random.default_rng(seed)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    ports = [system.get_input_port(i) for i in range(system.num_input_ports())]
    for port in ports:
        if find_good(port, 0) is None:
            message = (
                port.Allocate() if hasattr(port, "Allocate") else system.AllocateInputAbstract(port)
            )
            port.FixValue(context, message)
    for count in range(STEPS):
        for port in ports:
            good = find_good(port, count)
            if good is not None:
                fix(
                    system,
                    context,
                    port.get_name(),
                    spoil(good, rng) if rng.random() < FRACTION else good,
                )
        simulator.AdvanceTo((count + 1) * STEP)
        for i in range(system.num_output_ports()):
            system.get_output_port(i).Eval(context)
    return simulator


@pytest.mark.usefixtures("without_forecasts")
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", SYSTEMS)
def test_nothing_is_raised(name, seed):
    system = SYSTEMS[name]()
    context = simulate(system, seed).get_context()
    if name == "lcp":
        assert np.isfinite(system.GetOutputPort("pose").Eval(context)).all()


def test_the_picture_is_drawn_all_the_same():
    meshcat = Meshcat()
    simulate(EstimateVisualizer([ShownObject(OBJ, 0.03, body=1)], meshcat, path="seen"), 0)
    assert meshcat.HasPath("seen")


def command_executor(command):
    system = PushExecutor((0.5, 0.0, 0.2))
    simulator = Simulator(system)
    context = simulator.get_mutable_context()

    def tell(vector, seconds):
        system.GetInputPort("push_command").FixValue(context, np.array(vector, float))
        simulator.AdvanceTo(context.get_time() + seconds)
        return system.GetOutputPort("status").Eval(context)

    return tell


@pytest.mark.parametrize("at", range(1, 6))
def test_a_push_with_nan_is_refused(at):
    command = PushCommand(1, *PUSH).to_vector()
    command[at] = np.nan
    status = command_executor(None)(command, 0.1)
    assert (status.command_id, status.refused, status.executed) == (1, 1, 0)
    assert "not finite" in status.reason


def test_a_push_whose_number_is_nan_is_refused_and_does_no_harm():
    tell = command_executor(None)
    bad, good = [np.nan, *PUSH], PushCommand(1, *PUSH).to_vector()
    status = tell(bad, 0.5)
    assert (status.command_id, status.refused, status.ready) == (0, 1, True)
    assert "id is not finite" in status.reason
    status = tell(good, 0.1)
    assert (status.command_id, status.reason, status.ready) == (1, "", False)
    assert tell(bad, 0.1).reason == "", "a push under way is not broken off"
    done = tell(good, 10.0)
    assert (done.executed, done.refused) == (1, 1)
    assert tell(bad, 0.1).refused == 2
    again = tell(good, 1.0)
    assert (again.executed, again.ready, again.reason) == (1, True, ""), (
        "what was done is not done again"
    )


def test_a_grasp_with_nan_is_refused_and_an_unknown_gripper_is_waited_for():
    system = GraspExecutor()
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    fix(system, context, "push_tip_pose", GOOD["push_tip_pose"])
    port = system.GetInputPort("push_status")
    port.FixValue(context, system.AllocateInputAbstract(port))

    def tell(vector, gripper, seconds):
        fix(system, context, "grasp_command", np.array(vector, float))
        fix(system, context, "gripper_state", gripper)
        simulator.AdvanceTo(context.get_time() + seconds)
        return system.GetOutputPort("status").Eval(context)

    status = tell([np.nan, *GRASP], OPEN_GRIPPER, 0.1)
    assert (status.command_id, status.outcome, status.phase) == (
        0,
        GraspOutcome.REFUSED,
        GraspPhase.IDLE,
    )
    status = tell([1, *GRASP[:2], np.nan, *GRASP[3:]], OPEN_GRIPPER, 0.1)
    assert (status.command_id, status.outcome) == (1, GraspOutcome.REFUSED)
    assert "not finite" in status.reason
    status = tell(GraspCommand(2, *GRASP).to_vector(), np.full(4, np.nan), 30.0)
    assert (status.phase, status.reason) == ("closing", "the gripper's state is not finite")
    status = tell(GraspCommand(2, *GRASP).to_vector(), np.array([-0.01, 0.01, 0.0, 0.0]), 0.1)
    assert status.reason == "" and status.phase in ("closing", "lifting")


class Unlucky(GridIdentifier):
    """Cannot learn where its first push is among those learned from."""

    __slots__ = ()

    def Learn(self, log, start=None, weighings=None):
        if log[0].name == "push_1":
            raise np.linalg.LinAlgError("Eigenvalues did not converge")
        return super().Learn(log, start, weighings)


def test_a_push_that_nothing_can_be_learned_from_is_left_out(monkeypatch):
    monkeypatch.setattr("tests.helpers.poke_diagram.GridIdentifier", Unlucky)
    parts = make_poke_diagram(OBJ, UNIFORM, pokes=2, seed=1)
    simulator = Simulator(parts.diagram)
    context = parts.identifier.GetMyContextFromRoot(simulator.get_context())

    def read(port):
        return parts.identifier.GetOutputPort(port).Eval(context)

    messages = set()
    while read("num_pushes")[0] < 2 and context.get_time() < 60.0:
        simulator.AdvanceTo(context.get_time() + 0.2)
        messages.add(read("message"))
    assert messages == {"", "Nothing could be learned from push_1: Eigenvalues did not converge."}
    assert read("message") == "" and len(read("push_log")) == 2
    assert read("identification").push_names == ("push_2",)


@pytest.mark.slow
def test_a_whole_diagram_goes_on_learning():
    """Tip, pose and pusher are lost now and then, while it pokes: the tip may even pass through the object."""
    parts = make_poke_diagram(OBJ, UNIFORM, pokes=2, seed=1, spoiled=0.3)
    simulator = Simulator(parts.diagram)
    simulator.AdvanceTo(LONG)
    context = parts.identifier.GetMyContextFromRoot(simulator.get_context())
    assert parts.identifier.GetOutputPort("num_pushes").Eval(context)[0] > 0
    assert np.isfinite(parts.identifier.GetOutputPort("mass").Eval(context)).all()
