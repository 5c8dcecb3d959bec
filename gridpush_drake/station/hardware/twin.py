"""`MakeTwin`: a simulated robot with the LCM messages of a real one's drivers.

An ideal camera beside it says where each object is, as a tracker of real objects would.
"""

import numpy as np
from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, OutputPort
from pydrake.systems.lcm import LcmInterfaceSystem
from pydrake.systems.primitives import LinearSystem

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.station.arm_driver import DRIVER_OUTPUTS, AddArmDriver
from gridpush_drake.station.camera import StationCamera
from gridpush_drake.station.grasping import AddGripperController, ExportOutputs
from gridpush_drake.station.links.lcm.robot_messages import (
    ARM_PERIOD,
    AddGripperSide,
    AddObjectSender,
    find_arm_messages,
)
from gridpush_drake.station.others import AddOtherCameras, SetOthersStart
from gridpush_drake.station.resolve import ResolvedScenario, resolve
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.sensors import AddSensors
from gridpush_drake.station.setting import Setting
from gridpush_drake.station.station_plant import AddWorld, World
from gridpush_drake.systems.command_ramp import CommandRamp
from gridpush_drake.systems.planar_pose_sensor import PlanarPoseSensor

TORQUE = "torque_external"
"""Name of the port of an arm's driver with the torques from outside."""

ESTIMATION_TIME = 0.03
"""Time constant of an arm's estimate of the torques from outside, s. Without it a knock in the
simulation, which lasts one time step, would seem far stronger than a real one."""


def _AddCommandRamp(builder: DiagramBuilder, setting: Setting) -> CommandRamp:
    """Adds what brings the arm to rest when commands stop coming, as a real arm's driver does."""
    safety = setting.scenario.safety
    speed = setting.control_plant.GetVelocityUpperLimits()
    acceleration = np.full_like(speed, safety.acceleration)
    ramp = builder.AddNamedSystem(
        "command_ramp", CommandRamp(speed, acceleration, safety.command_age, ARM_PERIOD)
    )
    ExportOutputs(builder, ramp, "driver", ("status",))
    return ramp


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
    """A simulated robot on LCM, in real time or not.

    .. pydrake_system::

        name: Twin
        output_ports:
        - driver.status
        - other_0.pose
        - ...

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


def MakeTwin(
    scenario: PushScenario | ResolvedScenario, lcm: DrakeLcmInterface, *, listens: bool = True
) -> Twin:
    """Makes the twin: plant, driver, gripper and camera of a scenario, commanded over LCM.

    An ideal camera says the object's pose. Pictures of a color and depth camera are taken in
    another process, see `TwinCamera`.

    Args:
        scenario: the scenario, resolved or not.
        lcm: LCM on which the twin speaks.
        listens: whether the twin reads by itself what came whenever its time moves. All that comes
            must then be whole, for Drake ends the process over a command that is not. On a network
            with others, set it to False, and put a `TwinLink` between network and twin. (Drake 1.58
            cannot call Python from within an `LcmInterfaceSystem`.)

    Returns:
        The twin. Call its `SetStart` on each new Context.

    Raises:
        ScenarioError: the scenario makes no sense.
        StationError: the messages of the robot's driver are not known.
    """
    resolved = resolve(scenario)
    scenario = resolved.scenario
    builder = DiagramBuilder()
    # Of several objects the tracker is told the outlines: then no photograph is taken.
    world = AddWorld(builder, resolved, told=bool(resolved.others))
    setting = world.setting
    plant = world.plant
    robot = setting.robot
    instances = world.robot_in_plant
    if listens:
        builder.AddNamedSystem("lcm", LcmInterfaceSystem(lcm))

    # The arm, and what its driver does.
    driver = AddArmDriver(builder, plant, robot, instances.arm, setting.control_plant)
    messages = find_arm_messages(robot)
    ramp = _AddCommandRamp(builder, setting)
    builder.Connect(ramp.GetOutputPort("position"), driver.GetInputPort("position"))
    ports = {name: driver.GetOutputPort(name) for name in DRIVER_OUTPUTS}
    ports[TORQUE] = _AddLowPass(builder, ports[TORQUE], scenario.simulation.time_step)
    messages.AddRobotSide(builder, lcm, len(setting.q_start), ports, ramp)

    # The gripper, and what its driver does.
    if robot.gripper is not None:
        controller = AddGripperController(builder, plant, instances.gripper, robot.gripper)
        state = plant.get_state_output_port(instances.gripper)
        AddGripperSide(builder, lcm, controller, state, robot.gripper.opening)

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
            AddObjectSender(
                builder,
                lcm,
                pose,
                period=1 / scenario.camera.rate,
                # A pose is on the camera's port one time step after it was taken.
                offset=scenario.simulation.time_step,
                number=number,
            )
    twin = Twin(builder, world, camera, other_cameras)
    twin.set_name("twin")
    return twin
