"""`MakePushStation`: the simulated station, with table, object, robot and camera in one Diagram.

The robot knows the object's outline. The true masses and frictions of the object's cells go to the
plant alone. All other systems know the object through its camera, and the finger's tip through the
arm's joints. The plant with the truth is made in `station.simulated.plant`, the sensors in
`station.control.sensors`. What a simulated and a real station share is in
`station.simulated.station`.
"""

import numpy as np
from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams, Role, SceneGraph
from pydrake.systems.framework import Context, DiagramBuilder

from gridpush_drake.display.server import KeepToItsThread
from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.multibody.parser import find_drake_models
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.perception.images.camera_view import CameraView, SceneCameraView
from gridpush_drake.station.control.grasping import AddGripperController, ExportOutputs
from gridpush_drake.station.control.robot_control import (
    POSE_LOG,
    AddRobotControl,
    FeltLoad,
    Learning,
    RobotControl,
)
from gridpush_drake.station.control.sensors import (
    FORCE_PERIOD,
    AddLoadSensor,
    AddSceneView,
    AddSensors,
    SceneViewPorts,
    Sensors,
)
from gridpush_drake.station.robot.arm_driver import DRIVER_OUTPUTS, AddArmDriver
from gridpush_drake.station.scene.camera import StationCamera, calc_pose_age
from gridpush_drake.station.scene.other_objects import AddOtherCameras, SetOthersStart
from gridpush_drake.station.scene.resolve import ResolvedScenario, resolve
from gridpush_drake.station.scene.scene_camera import AddTruePoses
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.simulated.plant import AddWorld, World
from gridpush_drake.station.simulated.station import Station
from gridpush_drake.systems.execution.grasp_executor import GraspExecutor
from gridpush_drake.systems.learning.true_parameters import TrueParameters
from gridpush_drake.systems.sensing.arm_load_sensor import ArmLoadSensor
from gridpush_drake.systems.sensing.contact_force_sensor import ContactForceSensor
from gridpush_drake.systems.sensing.frame_times import FrameTimes
from gridpush_drake.systems.sensing.planar_pose_sensor import PlanarPoseSensor

TRUE_LOG = "true_pose_log"
COVARIANCE_LOG = "covariance_log"
"""Names of the systems that log the true pose and the covariance of a color and depth camera's."""

SCENE_LOG = "scene_pose_log"
TRUE_SCENE_LOG = "true_scene_pose_log"
"""Names of the systems that log the poses of all objects, as a camera follows them, and the true
ones."""


class PushStation(Station):
    """The simulated station.

    It has the ports of every `Station`, and the following, which need a simulation.

    .. pydrake_system::

        name: PushStation
        output_ports:
        - object.pose_true
        - body_poses
        - contact_results
        - query_object
        - pusher.force
        - other_0.pose
        - other_0.pose_true
        - ...
        - camera.message

    - ``object.pose_true``: vector of 3, true X_WB, (x, y, theta), m and rad, for display and for
      judging the task.
    - ``body_poses``: abstract list of `RigidTransform`, X_WB of the plant's bodies.
    - ``contact_results``: abstract `ContactResults` of the plant.
    - ``query_object``: abstract `QueryObject` of the scene graph.
    - ``pusher.force``: vector of 3, force on the finger's tip in W, N, only if the station is made
      with `steer_speed`.
    - ``other_0.pose`` and so on: vector of 3, X_WB of another object as its camera sees it,
      (x, y, theta), m and rad; one port for each of the scenario's `others`.
    - ``other_0.pose_true`` and so on: vector of 3, true X_WB of the same, for judging the task.
    - ``camera.message``: abstract `str`, why a color and depth camera that follows all objects has
      not found them yet; empty once it has. Only if the station is made with `several`.

    Attributes:
        scene_graph: the plant's scene graph.
        robot_in_plant: the robot's model instances in the plant.
        object_in_plant: the object's body and geometry in the plant.
        table: the table's collision geometries.
        gripper: the gripper's model instance; None if the scene has no gripper.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        builder: DiagramBuilder,
        world: World,
        control: RobotControl,
        camera: StationCamera,
        other_cameras: tuple[PlanarPoseSensor, ...],
        true_parameters: TrueParameters,
        load_sensor: ArmLoadSensor | None,
        meshcat: Meshcat | None,
    ) -> None:
        """Builds the Diagram of a builder's systems; `MakePushStation` calls it."""
        super().__init__(builder, world.setting, control, world.truth)
        self.scene_graph = world.scene_graph
        self.robot_in_plant = world.robot_in_plant
        self.object_in_plant = world.object_in_plant
        self.table = world.table
        self.gripper = world.robot_in_plant.gripper
        self._world = world
        self._camera = camera
        self._other_cameras = other_cameras
        self._kinematics = control.kinematics
        self._true_parameters = true_parameters
        self._load_sensor = load_sensor
        # Drake's visualizer keeps only the C++ server. The Python object must live as long as the
        # station: `KeepToItsThread` guards the server by it.
        self._meshcat = meshcat

    def SetStart(self, root_context: Context, seed: int | None = None) -> None:
        """Puts arm and objects at rest where the scenario has them. Call it on every fresh Context.

        Args:
            root_context: Context of the station, or of the Diagram that the station is part of.
            seed: seed of the hidden truth and the camera's noise, instead of the scenario's, so
                that one Diagram serves many runs.
        """
        truth = self._world.SetStart(self, root_context, seed)
        kinematics_context = self._kinematics.GetMyMutableContextFromRoot(root_context)
        self._kinematics.SetPositions(kinematics_context, self._world.setting.q_start)
        SetOthersStart(
            self.plant,
            self.scene_graph,
            root_context,
            scenario=self.scenario,
            others=self.others,
            cameras=self._other_cameras,
            seed=self.scenario.seed if seed is None else seed,
        )
        if seed is not None and truth is not None:
            self._true_parameters.SetParameters(root_context, truth)
            self._camera.SetSeed(root_context, seed)
            if self._load_sensor is not None:
                self._load_sensor.SetSeed(root_context, seed)

    def GetTruth(self, root_context: Context) -> CellParameters:
        """Returns the true parameters of the plant's object in a Context, as `SetStart` left them.

        Args:
            root_context: Context of the station, or of the Diagram that the station is part of.
        """
        return self._true_parameters.GetParameters(root_context)

    def FindCameraView(self, root_context: Context) -> CameraView | None:
        """Returns what the color and depth camera saw in a Context; None for an ideal camera.

        None is returned, too, for a camera that follows several objects, see `FindSceneView`.

        Args:
            root_context: Context of the station, or of the Diagram that the station is part of.
        """
        if self.found is None:
            return None
        t, poses = self._find_log(root_context, POSE_LOG)
        _, true_poses = self._find_log(root_context, TRUE_LOG)
        _, covariance = self._find_log(root_context, COVARIANCE_LOG)
        late = self._calc_lateness()
        errors = calc_late_errors(poses, true_poses, late)
        std = np.sqrt(covariance[late:].reshape(-1, 3, 3).diagonal(axis1=1, axis2=2))
        return CameraView(self.found.detected.close_up, t[late:], errors, std)

    def FindSceneView(self, root_context: Context) -> SceneCameraView | None:
        """Returns what a camera that follows all objects saw in a Context; None for others.

        Args:
            root_context: Context of the station, or of the Diagram that the station is part of.
        """
        if not self._camera.follows_multiple:
            return None
        t, poses = self._find_log(root_context, SCENE_LOG)
        _, true_poses = self._find_log(root_context, TRUE_SCENE_LOG)
        late = self._calc_lateness()
        shape = (len(t), -1, 3)
        return SceneCameraView(
            t[late:], calc_late_errors(poses.reshape(shape), true_poses.reshape(shape), late)
        )

    def _calc_lateness(self) -> int:
        """Calculates by how many pictures a pose that is seen is later in the logs than its truth.

        A true pose in the log is one picture old, for its sensor has the camera's rate. A pose that
        the camera saw may be older.
        """
        return round(calc_pose_age(self.scenario.camera) * self.scenario.camera.rate) - 1

    def CoverCamera(self, root_context: Context, covered: bool = True) -> None:
        """Covers the camera's lens, so that it sees no object, or uncovers it."""
        self._camera.SetCovered(root_context, covered)


def calc_late_errors(poses: Array, true_poses: Array, late: int) -> Array:
    """Calculates how far poses that come late are from the true ones of the same pictures.

    Args:
        poses: (K, ..., 3) poses seen, m and rad.
        true_poses: (K, ..., 3) the true ones.
        late: the pose in row k + late is of the picture whose truth is in row k.

    Returns:
        (K - late, ..., 3) the errors, m and rad.
    """
    errors = poses[late:] - true_poses[: len(true_poses) - late]
    errors[..., 2] = wrap_angle(errors[..., 2])
    return errors


def MakePushStation(
    scenario: PushScenario | ResolvedScenario,
    meshcat: Meshcat | None = None,
    *,
    show_object: bool = True,
    learning: Learning | None = None,
    steer_speed: float | None = None,
    several: bool = False,
    name: str = "station",
) -> PushStation:
    """Makes the simulated station.

    Building one takes far longer than beginning a run. For many runs build it once, and give every
    run a fresh Context (`CreateDefaultContext`, then `SetStart`), or `Simulator.reset_context` with
    one. All that differs between two runs is in the Context; two runs of one station may be
    interleaved.

    A station that nobody holds any more is freed by Python's garbage collector (`gc.collect()`),
    but for 1 MB or less that stays with Drake. If a part of the station, or a system connected to
    it, keeps a `RigidBody`, a `Joint`, a `Frame` or the ids of `GetCollisionGeometriesForBody` of
    its plant, the whole station stays in memory for good: keep their indices instead. So it does if
    one of them keeps whoever holds the station's Simulator, as by a method of a `StationTask`.

    Args:
        scenario: the scenario, resolved or not.
        meshcat: Meshcat in which the station is shown; None for none.
        show_object: whether the object's plain outline is shown; False if its estimate is drawn
            in its place.
        learning: which pushes are learned from; None for the first `scenario.pokes.count`.
        steer_speed: greatest speed at which the finger can be steered by the port `steer_command`,
            m/s; None for a station without this port.
        several: whether the task is with all objects. A color and depth camera then follows all of
            them, and the robot is told their outlines.
        name: name of the station in a Diagram, and of its path in Meshcat. Two stations in one
            Diagram must have different names.

    Returns:
        The station. Call its `SetStart` on each new Context.

    Raises:
        ScenarioError: the scenario makes no sense, see `resolve`.
        StationError: nothing can be rendered on this computer.
    """
    # The simulated world, its sensors and the driver of its arm.
    builder = DiagramBuilder()
    resolved = resolve(scenario)
    drake_models = find_drake_models() if meshcat is not None else None
    world = AddWorld(builder, resolved, show_object, drake_models, is_known=several)
    setting = world.setting
    robot = setting.robot
    instances = world.robot_in_plant
    driver = AddArmDriver(builder, world.plant, robot, instances.arm, setting.control_plant)
    sensors = AddSensors(
        builder,
        world.scene_graph,
        scenario=setting.scenario,
        robot=robot,
        part=world.object_in_plant,
        found=setting.found,
        followed=setting.others if several and setting.scenario.camera.kind == "rgbd" else (),
        table_top=setting.table_top,
    )
    other_cameras: tuple[PlanarPoseSensor, ...] = ()
    if not sensors.camera.follows_multiple:
        other_cameras = AddOtherCameras(builder, setting.scenario, setting.others)
    truths = AddTruePoses(builder, world.plant, setting.others, 1 / setting.scenario.camera.rate)
    scene_view = AddSceneView(builder, sensors, setting.others, truths)
    true_parameters = builder.AddNamedSystem("truth", TrueParameters(world.truth))

    # What commands the robot, as with a real one; it is connected to the simulated arm and gripper.
    load_sensor = (
        AddLoadSensor(builder, setting, driver) if setting.scenario.unknown_inertia else None
    )
    control = _add_control(
        builder,
        world,
        sensors,
        learning=learning,
        load_sensor=load_sensor,
        steer_speed=steer_speed,
        scene_view=scene_view,
    )
    builder.Connect(
        control.kinematics.GetOutputPort("joint_positions"), driver.GetInputPort("position")
    )
    if control.grasping is not None:
        _add_gripper(builder, world, control.grasping)
    builder.AddNamedSystem("frame_times", FrameTimes(MeshcatVisualizerParams().publish_period))
    if meshcat is not None:
        AddMeshcat(builder, world.scene_graph, meshcat, name)

    # The ports that only a simulation has.
    if setting.found is not None:
        ExportOutputs(builder, sensors.camera.source, "camera", ("covariance", "seen"))
    builder.ExportOutput(sensors.ground_truth.GetOutputPort("object_pose"), "object.pose_true")
    ExportOutputs(builder, driver, robot.arm_model, DRIVER_OUTPUTS)
    builder.ExportOutput(world.plant.get_body_poses_output_port(), "body_poses")
    builder.ExportOutput(world.plant.get_contact_results_output_port(), "contact_results")
    builder.ExportOutput(world.scene_graph.get_query_output_port(), "query_object")
    station = PushStation(
        builder,
        world,
        control,
        camera=sensors.camera,
        other_cameras=other_cameras,
        true_parameters=true_parameters,
        load_sensor=load_sensor,
        meshcat=meshcat,
    )
    station.set_name(name)
    return station


def _add_control(
    builder: DiagramBuilder,
    world: World,
    sensors: Sensors,
    learning: Learning | None,
    load_sensor: ArmLoadSensor | None,
    steer_speed: float | None,
    scene_view: SceneViewPorts | None,
) -> RobotControl:
    """Adds what commands the robot, and has the errors of a color and depth camera logged."""
    logged = None
    if scene_view is not None:
        logged = {SCENE_LOG: scene_view.poses, TRUE_SCENE_LOG: scene_view.true_poses}
    elif world.setting.found is not None:
        logged = {
            TRUE_LOG: sensors.ground_truth.GetOutputPort("object_pose"),
            COVARIANCE_LOG: sensors.camera.source.GetOutputPort("covariance"),
        }
    load = None
    if load_sensor is not None:
        load = FeltLoad(
            tip_force=load_sensor.GetOutputPort("tip_force"),
            smooth_tip_force=load_sensor.GetOutputPort("smooth_tip_force"),
            grasp_wrench=load_sensor.GetOutputPort("grasp_wrench"),
        )
    tip_force = None
    if steer_speed is not None:
        # the finger's tip, or all of a gripper that pushes
        robot = world.setting.robot
        if robot.tip is None:
            bodies = [world.plant.GetBodyByName(robot.finger.tip_frame).index()]
        else:
            gripper_model = world.plant.GetModelInstanceByName(robot.finger_model)
            bodies = world.plant.GetBodyIndices(gripper_model)
        felt = builder.AddNamedSystem(
            "force_sensor", ContactForceSensor(*bodies, period=FORCE_PERIOD)
        )
        builder.Connect(
            world.plant.get_contact_results_output_port(), felt.GetInputPort("contact_results")
        )
        tip_force = felt.GetOutputPort("force")
        builder.ExportOutput(tip_force, "pusher.force")
    gripper = world.robot_in_plant.gripper
    return AddRobotControl(
        builder,
        world.setting,
        learning,
        pusher_state=sensors.tip.GetOutputPort("pusher_state"),
        pusher_yaw=sensors.tip.GetOutputPort("pusher_yaw"),
        object_pose=sensors.camera.GetPose(),
        all_seen=None if scene_view is None else scene_view.all_seen,
        gripper_state=None if gripper is None else world.plant.get_state_output_port(gripper),
        logged=logged,
        load=load,
        tip_force=tip_force,
        steer_speed=steer_speed,
    )


def _add_gripper(builder: DiagramBuilder, world: World, grasping: GraspExecutor) -> None:
    """Adds the controller of the simulated gripper, and connects it to the executor of grasps."""
    gripper = world.robot_in_plant.gripper
    measures = world.setting.robot.gripper
    assert gripper is not None and measures is not None  # else nothing could grasp
    controller = AddGripperController(builder, world.plant, gripper, measures)
    builder.Connect(
        grasping.GetOutputPort("gripper_position"), controller.get_desired_position_input_port()
    )
    builder.Connect(
        grasping.GetOutputPort("gripper_force_limit"), controller.get_force_limit_input_port()
    )


def AddMeshcat(
    builder: DiagramBuilder, scene_graph: SceneGraph, meshcat: Meshcat, prefix: str = "station"
) -> MeshcatVisualizer:
    """Shows a scene in Meshcat by its illustration geometry.

    Args:
        builder: the builder that has the scene graph.
        scene_graph: the scene.
        meshcat: Meshcat in which it is shown.
        prefix: path in Meshcat below which everything is shown.

    Returns:
        The visualizer that was added.
    """
    KeepToItsThread(meshcat)
    params = MeshcatVisualizerParams(role=Role.kIllustration, prefix=prefix)
    return MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, params)
