"""`MakePushStation`: table, object, robot with a finger, camera, executor and identifier in one Diagram.

The station knows the object's outline. What its cells weigh and how they rub, the truth, goes to the plant alone;
everything else in the station sees the object through its camera, and the finger's tip through the joints.
"""

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import shapely
from numpy.typing import NDArray
from pydrake.geometry import GeometryId, Meshcat, MeshcatVisualizer, MeshcatVisualizerParams, Role, SceneGraph
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, OutputPort
from pydrake.systems.primitives import LogVectorOutput
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import ScenarioError, StationError
from gridpush_drake.geometry.se2 import wrap_angle
from gridpush_drake.multibody.contact_material import TABLE, FindTableOutline, SetPartner
from gridpush_drake.multibody.grid_object import AddGridObject, Base, GridObjectInPlant
from gridpush_drake.multibody.ground_truth import SetGridObjectParameters, SetGridObjectPose, resample_parameters
from gridpush_drake.multibody.parser import MakeParser
from gridpush_drake.multibody.visual_meshes import AddVisualMeshes, find_drake_models
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.pushes.segmentation import RecordOptions, Sample
from gridpush_drake.pushes.stream import make_samples
from gridpush_drake.report.camera_figure import Sight
from gridpush_drake.station.arm import (
    AddArmControl,
    ArmControl,
    ArmReach,
    CalcStartPosture,
    MakeControlPlant,
    SetArmStart,
)
from gridpush_drake.station.camera import (
    AddPoseEstimator,
    AddRgbdCamera,
    AddSeenVisual,
    FoundObject,
    PhotographedScene,
    StationCamera,
    calc_pose_age,
    find_object,
)
from gridpush_drake.station.grasping import (
    AddGrasping,
    AddPusherGate,
    ExportGrasping,
    ExportOutputs,
    make_grasp_trajectory_options,
)
from gridpush_drake.station.others import AddOtherCameras, AddOthers, OtherObject, SetOthersStart, leave_out
from gridpush_drake.station.robot import GetRobotInPlant, Robot, RobotInPlant, find_robot
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.scene import (
    AddScene,
    CalcBasePose,
    CalcHome,
    CalcTipReach,
    MakeSupport,
    MakeTruth,
    check_scenario,
    load_object,
)
from gridpush_drake.systems.grasp_executor import GraspExecutor
from gridpush_drake.systems.grid_identifier import GridIdentifier
from gridpush_drake.systems.messages import GraspCommand, PushCommand
from gridpush_drake.systems.planar_pose_sensor import PlanarPoseSensor
from gridpush_drake.systems.push_executor import PushExecutor, PushTrajectoryOptions, plan_push
from gridpush_drake.systems.pusher_state_sensor import PusherStateSensor
from gridpush_drake.systems.true_parameters import TrueParameters

LOST_BELOW = -0.01
"""z of the object's bottom in W below which the camera has lost it, m: it has left the table."""


@dataclass(frozen=True)
class Sensors:
    """What `AddSensors` put into a builder.

    Attributes:
        camera: sees the object, with noise.
        ground_truth: sees it as it is, for display and judgment.
        tip: knows where the tip is and how it moves.
    """

    camera: StationCamera
    ground_truth: PlanarPoseSensor
    tip: PusherStateSensor


def AddSensors(
    builder: DiagramBuilder,
    scene_graph: SceneGraph,
    scenario: PushScenario,
    robot: Robot,
    part: GridObjectInPlant,
    found: FoundObject | None,
) -> Sensors:
    """Adds the sensors, and connects them to the plant; `found` is what a color and depth camera tracks."""
    plant, body, period = part.plant, part.body.index(), 1 / scenario.camera.rate
    ground_truth = PlanarPoseSensor(body, period=period, lowest=LOST_BELOW)
    sensors = Sensors(
        _add_ideal_camera(builder, plant, scenario, part)
        if found is None
        else _add_rgbd_camera(builder, scene_graph, scenario, part, found),
        builder.AddNamedSystem("ground_truth_sensor", ground_truth),
        builder.AddNamedSystem("tip_sensor", PusherStateSensor(plant.GetBodyByName(robot.finger.tip_frame).index())),
    )
    tip = sensors.tip
    for sensor in (sensors.ground_truth, tip):
        builder.Connect(plant.get_body_poses_output_port(), sensor.GetInputPort("body_poses"))
    builder.Connect(plant.get_body_spatial_velocities_output_port(), tip.GetInputPort("body_spatial_velocities"))
    return sensors


def _add_ideal_camera(
    builder: DiagramBuilder, plant: MultibodyPlant, scenario: PushScenario, part: GridObjectInPlant
) -> StationCamera:
    camera = scenario.camera
    sensor = PlanarPoseSensor(
        part.body.index(),
        period=1 / camera.rate,
        position_noise=camera.position_noise,
        angle_noise=camera.angle_noise,
        lowest=LOST_BELOW,
        seed=scenario.seed,
    )
    builder.AddNamedSystem("camera", sensor)
    builder.Connect(plant.get_body_poses_output_port(), sensor.GetInputPort("body_poses"))
    return StationCamera(sensor)


def _add_rgbd_camera(
    builder: DiagramBuilder,
    scene_graph: SceneGraph,
    scenario: PushScenario,
    part: GridObjectInPlant,
    found: FoundObject,
) -> StationCamera:
    rgbd = AddRgbdCamera(builder, scene_graph, scenario, part)
    return StationCamera(AddPoseEstimator(builder, rgbd, scenario, found), rgbd.noise)


ESTIMATE_OUTPUTS = (
    "mass",
    "friction",
    "mass_std",
    "friction_std",
    "contact_friction",
    "center_of_mass",
    "center_of_mass_covariance",
    "loss",
    "num_pushes",
    "identification",
    "push_log",
    "message",
    "age",
)
"""Of the identifier, exported as `estimate.mass` and so on."""


@dataclass(frozen=True)
class Learning:
    """What the station's identifier learns from.

    Attributes:
        max_pushes: the first so many; None for no limit.
    """

    max_pushes: int | None = None


EDGE_DETAIL = 5e-4
"""m by which the edge may be simplified: of a round table to a polygon of few corners."""


def make_surface(table_top: BaseGeometry) -> SupportSurface:
    """The table's top as planners know it. Raises ScenarioError where it is in several pieces."""
    if not isinstance(table_top, Polygon):
        raise ScenarioError("directives: the table's top is in several pieces; expected one")
    return SupportSurface(shapely.simplify(table_top, EDGE_DETAIL))


def make_identifier(
    scenario: PushScenario, obj: GridObject, table_top: BaseGeometry, learning: Learning | None
) -> GridIdentifier:
    """The station's identifier: it knows the table's edge, and learns from the first `scenario.pokes.count` pushes."""
    learning = learning or Learning(scenario.pokes.count)
    return GridIdentifier(
        obj,
        period=1 / scenario.camera.rate,
        engaged_below=scenario.object_height,
        pusher_radius=obj.prior.pusher_radius,
        max_learning_pushes=learning.max_pushes,
        table=make_surface(table_top).corners if isinstance(table_top, Polygon) else None,
        warm_start=False,  # it gains little, and so `gridpush identify` finds the same from the log, bit for bit
        record=RecordOptions(pose_delay=calc_pose_age(scenario.camera)),
        answer_delay=scenario.simulation.answer_delay,
    )


PUSHER_LOG, POSE_LOG, TRUE_LOG, COVARIANCE_LOG = "pusher_log", "pose_log", "true_pose_log", "covariance_log"
"""Names of the systems that log what the identifier sees, and, of a color and depth camera, how well."""


def AddLogs(builder: DiagramBuilder, ports: dict[str, OutputPort], period: float) -> None:
    """Logs ports when the identifier looks: Drake publishes what was before the updates of the same time.

    Args:
        builder: the ports' systems are in it.
        ports: by the logs' names.
        period: s.
    """
    for name, port in ports.items():
        LogVectorOutput(port, builder, period).set_name(name)


def LoadPushedObject(scenario: PushScenario) -> GridObject:
    """Reads the scenario's object, with its finger as the pusher. Raises ScenarioError where there is none.

    In a planar plant every cell bears its own weight, however high it is pushed.
    """
    obj, finger = load_object(scenario), find_robot(scenario.directives).finger
    height = scenario.finger.push_height if scenario.base == "free" else None
    return replace(obj, prior=replace(obj.prior, pusher_radius=finger.tip_radius, push_height=height))


def AddStationScene(
    plant: MultibodyPlant, scene_graph: SceneGraph, scenario: PushScenario, robot: Robot
) -> tuple[RobotInPlant, tuple[GeometryId, ...]]:
    """Adds what the directives say; returns the robot and the table's collision geometries."""
    AddScene(MakeParser(plant), scenario)
    # a plant's own GetCollisionGeometriesForBody gives ids that keep it alive, unseen by the garbage collector
    inspector = scene_graph.model_inspector()
    table = tuple(
        geometry
        for body in plant.GetBodyIndices(plant.GetModelInstanceByName(TABLE))
        for geometry in inspector.GetGeometries(plant.GetBodyFrameIdOrThrow(body), Role.kProximity)
    )
    tip = plant.GetBodyByName(robot.finger.tip_frame)
    SetPartner(plant, scene_graph, [*table, *plant.GetCollisionGeometriesForBody(tip)])
    return GetRobotInPlant(plant, robot), table


def TakePhotograph(scenario: PushScenario, true_obj: GridObject) -> FoundObject:
    """Finds the object in a photograph of the scene as a run begins; see `find_object`."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, scenario.simulation.time_step)
    robot = find_robot(scenario.directives)
    instances, table = AddStationScene(plant, scene_graph, scenario, robot)
    truth = MakeTruth(true_obj, scenario.truth, scenario.seed)
    height, base = scenario.object_height, cast(Base, scenario.base)
    part = AddGridObject(plant, scene_graph, true_obj, truth, base, table=table, height=height, visual=False)
    AddSeenVisual(plant, scene_graph, part)
    plant.Finalize()
    control_plant = MakeControlPlant(robot, CalcBasePose(plant, robot))
    q_start = CalcStartPosture(control_plant, robot, CalcHome(plant, robot))
    table_top = FindTableOutline(plant, scene_graph.model_inspector())
    scene = PhotographedScene(plant, scene_graph, instances.arm, part, q_start, table_top)
    return find_object(scenario, true_obj, builder, scene)


IIWA_OUTPUTS = (
    "position_commanded",
    "position_measured",
    "velocity_estimated",
    "state_estimated",
    "torque_commanded",
    "torque_measured",
    "torque_external",
)
"""Of the driver, exported as `iiwa.position_commanded` and so on."""


@dataclass(frozen=True, eq=False)
class StationParts:
    """What a `PushStation` is made from; the first twelve are its attributes.

    Attributes:
        scenario, obj, truth, plant, scene_graph, robot, robot_in_plant: see `PushStation`.
        object_in_plant, table, table_top, style, home: likewise.
        reach: of the arm.
        control: of the arm.
        camera: sees the object, with noise.
        true_parameters: remembers the truth, on the robot's grid.
        grasping: carries out grasps; None where the scene has no gripper.
        others: see `PushStation`.
        other_cameras: see the others, with noise.
    """

    scenario: PushScenario
    obj: GridObject
    truth: CellParameters
    plant: MultibodyPlant
    scene_graph: SceneGraph
    robot: Robot
    robot_in_plant: RobotInPlant
    object_in_plant: GridObjectInPlant
    table: tuple[GeometryId, ...]
    table_top: BaseGeometry
    style: PushTrajectoryOptions
    home: tuple[float, float, float]
    reach: ArmReach
    control: ArmControl
    camera: StationCamera
    true_parameters: TrueParameters
    grasping: GraspExecutor | None
    others: tuple[OtherObject, ...]
    other_cameras: tuple[PlanarPoseSensor, ...]
    found: FoundObject | None


class PushStation(Diagram):
    """The station as a Diagram, with handles on what it was made from.

    .. pydrake_system::

        name: PushStation
        input_ports:
        - push_command
        - grasp_command
        output_ports:
        - executor.status
        - executor.tip_pose
        - pusher.state
        - object.pose
        - object.pose_true
        - estimate.mass
        - estimate.friction
        - ...
        - iiwa.position_measured
        - ...
        - body_poses
        - contact_results
        - query_object
        - grasp.status
        - gripper.state
        - other_0.pose
        - ...

    - ``push_command``: (6,) see `PushCommand`.
    - ``executor.status``: abstract `PushStatus`; ``executor.tip_pose``: abstract `RigidTransform`, X_WP desired.
    - ``pusher.state``: (6,) p_WP, m, and v_WP, m/s, of the tip's center, from the joints.
    - ``object.pose``: (3,) as the camera sees it, m and rad; ``object.pose_true``: as it is, for display and judgment.
    - ``estimate.*``: see `GridIdentifier`; ``iiwa.*``: see Drake's `SimIiwaDriver`; the three after: the plant's own.
    - Where the scene has a gripper: ``grasp_command``: (6,) see `GraspCommand`, need not be connected;
      ``grasp.status``: abstract `GraspStatus`; ``gripper.state``: (4,) the fingers' positions, left and right, m, and
      velocities, m/s. ``executor.tip_pose`` is then what push and grasp executor together desire.
    - ``other_0.pose`` and so on: (3,) of each of the scenario's other objects, as ``object.pose``.

    Attributes:
        scenario: what it was made from; with a color and depth camera, pose and height of the object are as seen.
        obj: the object, as the robot knows it.
        found: it in the photograph; None where the camera is ideal and the robot is told the object.
        truth: what the plant's object really weighs and how it rubs in a fresh Context, by the scenario's seed, on the
            cells of `obj`.
        plant: the plant.
        scene_graph: of the plant.
        robot: the robot's measures.
        robot_in_plant: its model instances in the plant.
        object_in_plant: the object in the plant.
        table: the table's collision geometries.
        table_top: where on it things may lie, a polygon in W, m.
        style: how the executor pushes.
        home: p_WP of the tip at the beginning, m.
        gripper: its model instance; None where the scene has none.
        others: further objects on the table.
    """

    __slots__ = NO_SLOTS

    def __init__(self, builder: DiagramBuilder, parts: StationParts) -> None:
        """Takes over a builder's systems; `MakePushStation` calls it."""
        super().__init__()
        self.scenario, self.obj, self.truth = parts.scenario, parts.obj, parts.truth
        self.plant, self.scene_graph, self.robot = parts.plant, parts.scene_graph, parts.robot
        self.robot_in_plant, self.home = parts.robot_in_plant, parts.home
        self.object_in_plant, self.table, self.table_top = parts.object_in_plant, parts.table, parts.table_top
        self.style, self.gripper, self.found = parts.style, parts.robot_in_plant.gripper, parts.found
        self._grasping, self._reach = parts.grasping, parts.reach
        self._control, self._camera, self._true_parameters = parts.control, parts.camera, parts.true_parameters
        self.others, self._other_cameras = parts.others, parts.other_cameras
        builder.BuildInto(self)

    def FindObstacle(self, command: PushCommand) -> str | None:
        """Says why the arm cannot carry out a push, come from its home; None where it can."""
        return plan_push(command, self.home, self.style, self._reach)[1]

    def FindGraspObstacle(self, command: GraspCommand) -> str | None:
        """Says why the arm cannot carry out a grasp, come from its home; None where it can.

        Raises:
            StationError: the scene has no gripper.
        """
        if self._grasping is None:
            raise StationError("the scene has no gripper; expected a model named gripper")
        return self._grasping.plan(command, (*self.home, 0.0))[1] or None

    def SetStart(self, root_context: Context, seed: int | None = None) -> None:
        """Puts arm and object where the scenario has them, at rest. Call it on every fresh Context.

        Args:
            root_context: of the station, or of the Diagram it is part of.
            seed: of the hidden truth and the camera's noise, instead of the scenario's: one Diagram serves many runs.
        """
        SetArmStart(self, root_context, self.plant, self.robot_in_plant.arm, self._control)
        plant_context = self.plant.GetMyMutableContextFromRoot(root_context)
        SetGridObjectPose(self.plant, plant_context, self.object_in_plant, self.scenario.object_pose)
        SetOthersStart(
            self.plant, self.scene_graph, root_context, self.scenario, self.others, self._other_cameras,
            self.scenario.seed if seed is None else seed,
        )  # fmt: skip
        if seed is not None:
            true_obj = self.object_in_plant.obj
            truth = MakeTruth(true_obj, self.scenario.truth, seed)
            support = MakeSupport(true_obj, truth, self.scenario, seed)
            SetGridObjectParameters(self.plant, self.scene_graph, root_context, self.object_in_plant, truth, support)
            self._true_parameters.SetParameters(root_context, resample_parameters(true_obj, truth, self.obj))
            self._camera.SetSeed(root_context, seed)

    def GetTruth(self, root_context: Context) -> CellParameters:
        """What the plant's object really weighs and how it rubs in a Context, as `SetStart` left it.

        Args:
            root_context: of the station, or of the Diagram it is part of.
        """
        return self._true_parameters.GetParameters(root_context)

    def FindStream(self, root_context: Context) -> list[Sample]:
        """All that the identifier has seen in a Context: the stream that its pushes were cut from.

        Args:
            root_context: of the station, or of the Diagram it is part of.
        """
        t, tip = self._find_log(root_context, PUSHER_LOG)
        return make_samples(t, tip[:, :3], tip[:, 3:], self._find_log(root_context, POSE_LOG)[1])

    def FindSight(self, root_context: Context) -> Sight | None:
        """What the color and depth camera saw in a Context, and how far off that was; None for an ideal camera.

        Args:
            root_context: of the station, or of the Diagram it is part of.
        """
        if self.found is None:
            return None
        (t, poses), (_, true), (_, covariance) = (
            self._find_log(root_context, name) for name in (POSE_LOG, TRUE_LOG, COVARIANCE_LOG)
        )
        late = round(calc_pose_age(self.scenario.camera) * self.scenario.camera.rate) - 1
        errors = poses[late:] - true[: len(true) - late]
        errors[:, 2] = wrap_angle(errors[:, 2])
        std = np.sqrt(covariance[late:].reshape(-1, 3, 3).diagonal(axis1=1, axis2=2))
        return Sight(self.found.detected.picture, t[late:], errors, std)

    def _find_log(self, root_context: Context, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Times (K,), s, and values (K, d). The logs are no attributes: they would keep the station alive for good."""
        log = self.GetSubsystemByName(name).FindLog(root_context)
        return log.sample_times(), log.data().T

    def CoverCamera(self, root_context: Context, covered: bool = True) -> None:
        """Covers the camera, which then sees no object, or uncovers it."""
        self._camera.SetCovered(root_context, covered)


def MakePushStation(
    scenario: PushScenario,
    meshcat: Meshcat | None = None,
    *,
    show_object: bool = True,
    learning: Learning | None = None,
    name: str = "station",
) -> PushStation:
    """Makes the station.

    Building one takes far longer than to begin anew: for many runs build it once, and give every run a fresh Context
    (`CreateDefaultContext`, then `SetStart`), or `Simulator.reset_context` with one. All that differs between two runs
    is in the Context; two runs of one station may be interleaved. A station that nobody holds any more is freed by
    Python's garbage collector (`gc.collect()`) but for 1 MB or less that stays with Drake. Whoever keeps a `RigidBody`,
    a `Joint`, a `Frame` or the ids of `GetCollisionGeometriesForBody` of its plant as a part of the station, or of what
    it is connected to, keeps all of it for good: keep their indices instead.

    Args:
        scenario: what stands where.
        meshcat: to show it in; None for none.
        show_object: whether the object's plain outline is shown; not where its estimate is drawn in its place.
        learning: what is learned from; the first `scenario.pokes.count` pushes by default.
        name: of the station in a Diagram, and of what is shown in Meshcat; stations in one Diagram have names of their
            own.

    Returns:
        The station. Call its `SetStart` on each new Context.

    Raises:
        ScenarioError: the scenario makes no sense, see `check_scenario`.
        StationError: the arm cannot take the posture in which it begins.
    """
    check_scenario(scenario)
    obj = true_obj = LoadPushedObject(scenario)
    found = None
    if scenario.camera.kind == "rgbd":
        found = TakePhotograph(scenario, true_obj)
        obj, true_obj = found.obj, found.true_obj
    true_truth = MakeTruth(true_obj, scenario.truth, scenario.seed)
    truth = resample_parameters(true_obj, true_truth, obj)
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, scenario.simulation.time_step)
    plant.set_name("plant")
    plant.set_stiction_tolerance(scenario.simulation.stiction_tolerance)
    scene_graph.set_name("scene_graph")
    robot = find_robot(scenario.directives)
    instances, table = AddStationScene(plant, scene_graph, scenario, robot)
    object_in_plant = AddGridObject(
        plant,
        scene_graph,
        true_obj,
        true_truth,
        cast(Base, scenario.base),
        table=table,
        height=scenario.object_height,
        support=MakeSupport(true_obj, true_truth, scenario, scenario.seed),
        visual=show_object,
    )
    others = AddOthers(plant, scene_graph, scenario, table, object_in_plant)
    if found is not None:
        AddSeenVisual(plant, scene_graph, object_in_plant)
        seen = {"object_pose": found.pose.tolist(), "object_height": obj.height or scenario.object_height}
        scenario = scenario.model_copy(update=seen)
    drake_models = find_drake_models() if meshcat is not None else None
    if drake_models is not None:
        AddVisualMeshes(plant, scene_graph, drake_models)
    plant.Finalize()

    home, control_plant = CalcHome(plant, robot), MakeControlPlant(robot, CalcBasePose(plant, robot))
    q_start = CalcStartPosture(control_plant, robot, home)
    control = AddArmControl(builder, plant, robot, instances.arm, control_plant, q_start)
    reach, style = ArmReach(control_plant, robot, q_start), make_style(scenario, robot)
    executor = builder.AddNamedSystem("executor", PushExecutor(home, obj.outline, reach, style))
    sensors = AddSensors(builder, scene_graph, scenario, robot, object_in_plant, found)
    camera, tip = sensors.camera.source, sensors.tip
    other_cameras = AddOtherCameras(builder, plant, scenario, others, LOST_BELOW)
    table_top = FindTableOutline(plant, scene_graph.model_inspector())
    true_parameters = builder.AddNamedSystem("truth", TrueParameters(truth))
    identifier = builder.AddNamedSystem("identifier", make_identifier(scenario, obj, table_top, learning))

    grasping = None
    if robot.gripper is not None:
        grasping_style = make_grasp_trajectory_options(scenario, control_plant, robot.gripper, robot.finger.tip_frame)
        grasping = AddGrasping(
            builder, plant, instances.gripper, robot.gripper, executor, reach, table_top, grasping_style
        )
    desired = executor if grasping is None else grasping
    builder.Connect(desired.GetOutputPort("tip_pose"), control.tip_pose)
    for consumer in (executor, identifier):
        builder.Connect(camera.GetOutputPort("object_pose"), consumer.GetInputPort("object_pose"))
    pusher = tip if grasping is None else AddPusherGate(builder, tip, grasping)
    builder.Connect(pusher.GetOutputPort("pusher_state"), identifier.GetInputPort("pusher_state"))
    logged = {PUSHER_LOG: pusher.GetOutputPort("pusher_state"), POSE_LOG: camera.GetOutputPort("object_pose")}
    if found is not None:
        logged[TRUE_LOG] = sensors.ground_truth.GetOutputPort("object_pose")
        logged[COVARIANCE_LOG] = camera.GetOutputPort("covariance")
    AddLogs(builder, logged, 1 / scenario.camera.rate)
    if meshcat is not None:
        AddMeshcat(builder, scene_graph, meshcat, name)

    if found is not None:
        ExportOutputs(builder, camera, "camera", ("covariance", "seen"))
    builder.ExportInput(executor.GetInputPort("push_command"), "push_command")
    ExportOutputs(builder, executor, "executor", ("status",))
    ExportOutputs(builder, desired, "executor", ("tip_pose",))
    builder.ExportOutput(tip.GetOutputPort("pusher_state"), "pusher.state")
    builder.ExportOutput(camera.GetOutputPort("object_pose"), "object.pose")
    builder.ExportOutput(sensors.ground_truth.GetOutputPort("object_pose"), "object.pose_true")
    ExportOutputs(builder, identifier, "estimate", ESTIMATE_OUTPUTS)
    ExportOutputs(builder, control.driver, "iiwa", IIWA_OUTPUTS)
    builder.ExportOutput(plant.get_body_poses_output_port(), "body_poses")
    builder.ExportOutput(plant.get_contact_results_output_port(), "contact_results")
    builder.ExportOutput(scene_graph.get_query_output_port(), "query_object")
    if grasping is not None:
        ExportGrasping(builder, plant, instances.gripper, grasping)
    station = PushStation(
        builder,
        StationParts(
            scenario, obj, truth, plant, scene_graph, robot, instances, object_in_plant, table, table_top, style, home,
            reach, control, sensors.camera, true_parameters, grasping, others, other_cameras, found,
        ),
    )  # fmt: skip
    station.set_name(name)
    return station


def make_style(scenario: PushScenario, robot: Robot) -> PushTrajectoryOptions:
    """How the scenario's finger pushes."""
    finger = scenario.finger
    return PushTrajectoryOptions(
        travel_height=finger.travel_height, push_height=finger.push_height, tip_radius=robot.finger.tip_radius
    )


def AddMeshcat(
    builder: DiagramBuilder, scene_graph: SceneGraph, meshcat: Meshcat, prefix: str = "station"
) -> MeshcatVisualizer:
    """Shows the illustration geometry, and nothing else, below the path `prefix`."""
    params = MeshcatVisualizerParams(role=Role.kIllustration, prefix=prefix)
    return MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, params)


RING_SEGMENTS = 32
"""A quarter turn, of the polygon for a ring."""


def MakeFingerRegion(station: PushStation, inset: float = 0.0) -> BaseGeometry:
    """Makes the region in which the tip's center may be while it pushes.

    Args:
        station: the station.
        inset: least distance from the region's edge, m.

    Returns:
        The region, W, m: the ring that the arm reaches, and in it the workspace, without the places where the tip would
        touch another object; it may be empty.
    """
    workspace = station.scenario.workspace
    box = shapely.box(workspace.x[0], workspace.y[0], workspace.x[1], workspace.y[1])
    axis, least, greatest = CalcTipReach(station.plant, station.robot, station.scenario.finger.push_height)
    region = MakeRing(axis, least + inset, greatest - inset) & box.buffer(-inset)
    return leave_out(region, station.others, station.robot.finger.tip_radius + inset)


def MakeRing(axis: NDArray[np.float64], least: float, greatest: float) -> shapely.Polygon:
    """The places about the robot's axis (2,) between two distances, m."""
    outer, inner = (shapely.Point(axis).buffer(radius, RING_SEGMENTS) for radius in (greatest, least))
    return outer - inner
