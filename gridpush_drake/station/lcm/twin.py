"""`MakeTwin`: a simulated robot that speaks what a real one's drivers speak, and what tells the pose it sees."""

import numpy as np
from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, OutputPort
from pydrake.systems.lcm import LcmInterfaceSystem
from pydrake.systems.primitives import LinearSystem

from gridpush_drake.errors import ScenarioError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.station.arm_driver import DRIVER_OUTPUTS, AddArmDriver
from gridpush_drake.station.camera import StationCamera
from gridpush_drake.station.grasping import AddGripperController, ExportOutputs
from gridpush_drake.station.lcm.robot_messages import (
    ARM_PERIOD,
    AddGripperSide,
    AddObjectSender,
    find_arm_messages,
)
from gridpush_drake.station.push_station import AddSensors, AddWorld, World
from gridpush_drake.station.resolve import ResolvedScenario, resolve
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.station import Setting
from gridpush_drake.systems.command_ramp import CommandRamp

TORQUE = "torque_external"
"""Name of the port of an arm's driver with the torques from outside."""

ESTIMATION_TIME = 0.03
"""Time constant with which an arm's estimate of the torques from outside follows them, s. In the
simulation a knock lasts one time step, and is as much stronger."""


def check_tracked(scenario: PushScenario) -> None:
    """Raises ScenarioError where a scenario has what cannot be told over LCM: several objects."""
    if scenario.others:
        raise ScenarioError("others: over LCM one object's pose is told; expected an empty list")


def _AddCommandRamp(builder: DiagramBuilder, setting: Setting) -> CommandRamp:
    safety, speed = setting.scenario.safety, setting.control_plant.GetVelocityUpperLimits()
    acceleration = np.full_like(speed, safety.acceleration)
    ramp = builder.AddNamedSystem(
        "command_ramp", CommandRamp(speed, acceleration, safety.command_age, ARM_PERIOD)
    )
    ExportOutputs(builder, ramp, "driver", ("status",))
    return ramp


def _AddLowPass(builder: DiagramBuilder, port: OutputPort, period: float) -> OutputPort:
    """The torques from outside as an arm estimates them: a knock is spread over some time."""
    keep, size = np.exp(-period / ESTIMATION_TIME), port.size()
    A, B = keep * np.eye(size), (1 - keep) * np.eye(size)
    low_pass = LinearSystem(A=A, B=B, C=np.eye(size), D=np.zeros((size, size)), time_period=period)
    builder.AddNamedSystem("torque_estimator", low_pass)
    builder.Connect(port, low_pass.get_input_port())
    return low_pass.get_output_port()


class Twin(Diagram):
    """A simulated robot on LCM, in real time or not.

    .. pydrake_system::

        name: Twin
        output_ports:
        - driver.status

    - ``driver.status``: abstract `GuardStatus` of its `CommandRamp`.

    Attributes:
        world: plant, robot, object and table.
    """

    __slots__ = NO_SLOTS

    def __init__(self, builder: DiagramBuilder, world: World, camera: StationCamera) -> None:
        """Takes over a builder's systems; `MakeTwin` calls it."""
        super().__init__()
        self.world, self._camera = world, camera
        builder.BuildInto(self)

    def GetPositions(self, root_context: Context) -> Array:
        """All positions of the world's plant, as `TwinCamera` takes them."""
        plant = self.world.plant
        return np.array(plant.GetPositions(plant.GetMyContextFromRoot(root_context)))

    def SetStart(self, root_context: Context, seed: int | None = None) -> None:
        """Puts arm and object where the scenario has them, at rest; see `PushStation.SetStart`."""
        self.world.SetStart(self, root_context, seed)
        if seed is not None:
            self._camera.SetSeed(root_context, seed)


def MakeTwin(
    scenario: PushScenario | ResolvedScenario, lcm: DrakeLcmInterface, *, listens: bool = True
) -> Twin:
    """Makes the twin: plant, driver, gripper and camera of a scenario, with LCM in the place of what commands them.

    An ideal camera says the object's pose; pictures of an rgbd one are taken beside it, see
    `TwinCamera`.

    Args:
        scenario: what stands where, resolved or not, and what the object truly weighs.
        lcm: on which it speaks.
        listens: whether it hears what came whenever its time moves; what comes must then be whole,
            for Drake ends the process over a command that is not. On a network that others are on,
            the caller has a `TwinLink` between that and the twin, and none of this. Drake 1.58
            cannot call Python from within an `LcmInterfaceSystem`.

    Returns:
        The twin. Call its `SetStart` on each new Context.

    Raises:
        ScenarioError: the scenario makes no sense, or has several objects.
        StationError: the arm cannot take the posture in which it begins.
    """
    resolved = resolve(scenario)
    scenario = resolved.scenario
    check_tracked(scenario)
    builder = DiagramBuilder()
    world = AddWorld(builder, resolved)
    setting, plant = world.setting, world.plant
    robot, instances = setting.robot, world.robot_in_plant
    if listens:
        builder.AddNamedSystem("lcm", LcmInterfaceSystem(lcm))
    driver = AddArmDriver(builder, plant, robot, instances.arm, setting.control_plant)
    messages = find_arm_messages(robot)
    ramp, ports = (
        _AddCommandRamp(builder, setting),
        {name: driver.GetOutputPort(name) for name in DRIVER_OUTPUTS},
    )
    builder.Connect(ramp.GetOutputPort("position"), driver.GetInputPort("position"))
    ports[TORQUE] = _AddLowPass(builder, ports[TORQUE], scenario.simulation.time_step)
    messages.AddRobotSide(builder, lcm, len(setting.q_start), ports, ramp)
    if robot.gripper is not None:
        controller = AddGripperController(builder, plant, instances.gripper, robot.gripper)
        state = plant.get_state_output_port(instances.gripper)
        AddGripperSide(builder, lcm, controller, state, robot.gripper.opening)
    camera = AddSensors(
        builder, world.scene_graph, setting.scenario, robot, world.object_in_plant, None
    ).camera
    if scenario.camera.kind == "ideal":
        time_step = scenario.simulation.time_step  # after which a pose is on its port
        AddObjectSender(
            builder,
            lcm,
            camera.source.GetOutputPort("object_pose"),
            1 / scenario.camera.rate,
            time_step,
        )
    twin = Twin(builder, world, camera)
    twin.set_name("twin")
    return twin
