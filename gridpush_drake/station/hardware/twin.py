"""`MakeTwin`: a simulated robot that speaks as a real one's drivers do.

An ideal camera beside it says where each object is, as a tracker of real objects would.
"""

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.manipulation import MakeMultibodyStateToWsgStateSystem
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import LinearSystem

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.station.control.grasping import AddGripperController, ExportOutputs
from gridpush_drake.station.control.sensors import AddSensors
from gridpush_drake.station.links.link import ARM_PERIOD, GRIPPER_PERIOD, Record
from gridpush_drake.station.robot.arm_driver import DRIVER_OUTPUTS, STATUS_PORTS, AddArmDriver
from gridpush_drake.station.scene.camera import StationCamera
from gridpush_drake.station.scene.other_objects import AddOtherCameras, SetOthersStart
from gridpush_drake.station.scene.resolve import ResolvedScenario, resolve
from gridpush_drake.station.scene.setting import StationSetting
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.simulated.plant import AddWorld, World
from gridpush_drake.systems.record_ports import RecordReader, RecordSender
from gridpush_drake.systems.robot_records import (
    ArmCommand,
    ArmStatus,
    GripperCommand,
    GripperStatus,
    PoseObservation,
)
from gridpush_drake.systems.safety.command_ramp import CommandRamp
from gridpush_drake.systems.sensing.planar_pose_sensor import PlanarPoseSensor

TORQUE = "torque_external"
"""Name of the port of an arm's driver with the torques from outside."""

ESTIMATION_TIME = 0.03
"""Time constant of an arm's estimate of the torques from outside, s. Without it a knock in the
simulation, which lasts one time step, would seem far stronger than a real one."""


FIRST_FORCE = 40.0
"""Greatest force of a gripper until its first command, N."""

SendRecord = Callable[[Record], None]
"""A function that takes what a twin says, such as a link's `send`."""


def _AddCommandRamp(builder: DiagramBuilder, setting: StationSetting) -> CommandRamp:
    """Adds what brings the arm to rest when commands stop coming, as a real arm's driver does."""
    safety = setting.scenario.safety
    speed = setting.control_plant.GetVelocityUpperLimits()
    acceleration = np.full_like(speed, safety.acceleration)
    ramp = builder.AddNamedSystem(
        "command_ramp", CommandRamp(speed, acceleration, safety.command_age, ARM_PERIOD)
    )
    builder.ExportInput(ramp.GetInputPort("command"), "arm_command")
    ExportOutputs(builder, ramp, "driver", ("status",))
    return ramp


def _AddArmStatus(
    builder: DiagramBuilder, ports: Mapping[str, OutputPort], send: SendRecord
) -> None:
    """Adds what says how the arm is.

    Args:
        builder: the builder that has the arm's driver.
        ports: output ports of the driver, by name.
        send: takes the statuses.
    """
    sizes = {name: ports[port].size() for name, port in STATUS_PORTS.items()}
    sender = builder.AddNamedSystem(
        "arm_status_sender", RecordSender(ArmStatus, sizes, send, period=ARM_PERIOD)
    )
    for name, port in STATUS_PORTS.items():
        builder.Connect(ports[port], sender.GetInputPort(name))


def _AddGripperDriver(
    builder: DiagramBuilder,
    controller: System,
    state: OutputPort,
    opening: float,
    send: SendRecord,
) -> None:
    """Adds what the driver of a real gripper does, to a simulated one.

    Args:
        builder: the builder that has the gripper's controller.
        controller: moves the simulated gripper.
        state: (4,) positions of its fingers, m, and their velocities, m/s.
        opening: opening until the first command, m.
        send: takes the gripper's statuses.
    """
    commands = builder.AddNamedSystem(
        "gripper_command_reader",
        RecordReader(
            GripperCommand(0.0, opening, FIRST_FORCE),
            {"opening": lambda command: command.opening, "force": lambda command: command.force},
        ),
    )
    builder.ExportInput(commands.get_input_port(), "gripper_command")
    builder.Connect(commands.GetOutputPort("opening"), controller.get_desired_position_input_port())
    builder.Connect(commands.GetOutputPort("force"), controller.get_force_limit_input_port())
    gap = builder.AddNamedSystem("gripper_opening", MakeMultibodyStateToWsgStateSystem())
    builder.Connect(state, gap.get_input_port())

    def make(time: float, state: Array, force: Array) -> GripperStatus:
        opening, speed = state.tolist()
        return GripperStatus(time, opening, speed, float(force[0]))

    sender = builder.AddNamedSystem(
        "gripper_status_sender",
        RecordSender(make, {"state": 2, "force": 1}, send, period=GRIPPER_PERIOD),
    )
    builder.Connect(gap.get_output_port(), sender.GetInputPort("state"))
    builder.Connect(controller.get_grip_force_output_port(), sender.GetInputPort("force"))


def _AddLowPass(builder: DiagramBuilder, port: OutputPort, period: float) -> OutputPort:
    """Adds an arm's estimate of the torques from outside, which spreads a knock over some time.

    It is x' = keep x + (1 - keep) u in each period, s, with keep = exp(-period / ESTIMATION_TIME).
    """
    keep = np.exp(-period / ESTIMATION_TIME)
    size = port.size()
    low_pass = LinearSystem(
        A=keep * np.eye(size),
        B=(1 - keep) * np.eye(size),
        C=np.eye(size),
        D=np.zeros((size, size)),
        time_period=period,
    )
    builder.AddNamedSystem("torque_estimator", low_pass)
    builder.Connect(port, low_pass.get_input_port())
    return low_pass.get_output_port()


class Twin(Diagram):
    """A simulated robot that is commanded by records, in real time or not.

    .. pydrake_system::

        name: Twin
        input_ports:
        - arm_command
        - gripper_command
        output_ports:
        - driver.status
        - other_0.pose
        - ...

    - ``arm_command``: abstract `ArmCommand`, the last one. It need not be connected: then the arm
      stays where it is.
    - ``gripper_command``: abstract `GripperCommand`, the last one, likewise; only with a gripper.
    - ``driver.status``: abstract `GuardStatus` of its `CommandRamp`, how the arm's driver stands.
    - ``other_0.pose`` and so on: as in a `PushStation`.

    Attributes:
        world: the simulated plant with robot, object and table.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        builder: DiagramBuilder,
        world: World,
        camera: StationCamera,
        other_cameras: tuple[PlanarPoseSensor, ...] = (),
    ) -> None:
        """Builds the Diagram of a builder's systems; `MakeTwin` calls it."""
        super().__init__()
        self.world = world
        self._camera = camera
        self._other_cameras = other_cameras
        builder.BuildInto(self)

    def GetPositions(self, root_context: Context) -> Array:
        """Returns all positions of the world's plant in a Context, as `TwinCamera` takes them."""
        plant = self.world.plant
        return np.array(plant.GetPositions(plant.GetMyContextFromRoot(root_context)))

    def TakeCommand(self, root_context: Context, command: ArmCommand | GripperCommand) -> None:
        """Sets the input port of a command in a Context in which nothing is connected to it."""
        name = "arm_command" if isinstance(command, ArmCommand) else "gripper_command"
        context = self.GetMyMutableContextFromRoot(root_context)
        self.GetInputPort(name).FixValue(context, AbstractValue.Make(command))

    def SetStart(self, root_context: Context, seed: int | None = None) -> None:
        """Puts arm and objects at rest where the scenario has them; see `PushStation.SetStart`."""
        self.world.SetStart(self, root_context, seed)
        setting = self.world.setting
        SetOthersStart(
            self.world.plant,
            self.world.scene_graph,
            root_context,
            scenario=setting.scenario,
            others=setting.others,
            cameras=self._other_cameras,
            seed=setting.scenario.seed if seed is None else seed,
        )
        if seed is not None:
            self._camera.SetSeed(root_context, seed)


def MakeTwin(scenario: PushScenario | ResolvedScenario, send: SendRecord) -> Twin:
    """Makes the twin: plant, driver, gripper and camera of a scenario.

    It says by itself how robot and objects are, and takes commands by `Twin.TakeCommand`, whose
    numbers must be finite: put a `TwinLink` between a network and the twin. An ideal camera says
    the object's pose. Pictures of a color and depth camera are taken in another process, see
    `TwinCamera`.

    Args:
        scenario: the scenario, resolved or not.
        send: takes what the twin says: `ArmStatus`, `GripperStatus` and `PoseObservation`.

    Returns:
        The twin. Call its `SetStart` on each new Context.

    Raises:
        ScenarioError: the scenario makes no sense.
    """
    resolved = resolve(scenario)
    scenario = resolved.scenario
    builder = DiagramBuilder()
    # Of several objects the tracker is told the outlines: then no photograph is taken.
    world = AddWorld(builder, resolved, is_known=bool(resolved.others))
    setting = world.setting
    plant = world.plant
    robot = setting.robot
    instances = world.robot_in_plant

    # The arm, and what its driver does.
    driver = AddArmDriver(builder, plant, robot, instances.arm, setting.control_plant)
    ramp = _AddCommandRamp(builder, setting)
    builder.Connect(ramp.GetOutputPort("position"), driver.GetInputPort("position"))
    ports = {name: driver.GetOutputPort(name) for name in DRIVER_OUTPUTS}
    ports[TORQUE] = _AddLowPass(builder, ports[TORQUE], scenario.simulation.time_step)
    builder.Connect(ports["position_measured"], ramp.GetInputPort("position_measured"))
    _AddArmStatus(builder, ports, send)

    # The gripper, and what its driver does.
    if robot.gripper is not None:
        controller = AddGripperController(builder, plant, instances.gripper, robot.gripper)
        state = plant.get_state_output_port(instances.gripper)
        _AddGripperDriver(builder, controller, state, robot.gripper.opening, send)

    # The camera, and what a tracker does.
    camera = AddSensors(
        builder,
        world.scene_graph,
        scenario=setting.scenario,
        robot=robot,
        part=world.object_in_plant,
        found=None,
    ).camera
    other_cameras = AddOtherCameras(builder, setting.scenario, setting.others)
    if scenario.camera.kind == "ideal":
        poses = [camera.GetPose(), *(each.GetOutputPort("object_pose") for each in other_cameras)]
        for number, pose in enumerate(poses):
            sender = builder.AddNamedSystem(
                f"pose_sender_{number}",
                RecordSender(
                    partial(PoseObservation, number=number),
                    {"pose": 3},
                    send,
                    period=1 / scenario.camera.rate,
                    # A pose is on the camera's port one time step after it was taken.
                    offset=scenario.simulation.time_step,
                ),
            )
            builder.Connect(pose, sender.get_input_port())
    twin = Twin(builder, world, camera, other_cameras)
    twin.set_name("twin")
    return twin
