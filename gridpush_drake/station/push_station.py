"""`MakePushStation`: table, object, iiwa with a finger, camera, executor and identifier in one Diagram.

The station knows the object's outline. What its cells weigh and how they rub, the truth, goes to the plant alone;
everything else in the station sees the object through its camera.
"""

from dataclasses import dataclass
from typing import cast

from pydrake.geometry import (
    GeometryId,
    Meshcat,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    Role,
    SceneGraph,
)
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import StationError
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.scene.grid_object import AddGridObject, Base, GridObjectInPlant
from gridpush_drake.scene.grid_object_state import SetGridObjectParameters, SetGridObjectPose
from gridpush_drake.scene.scenario import PushScenario
from gridpush_drake.scene.scenario_check import check_scenario
from gridpush_drake.scene.skin import AddSkin, find_drake_models
from gridpush_drake.scene.table import FindTableOutline
from gridpush_drake.scene.truth import MakeTruth
from gridpush_drake.station.arm_posture import CalcStartPosture
from gridpush_drake.station.arm_reach import ArmReach
from gridpush_drake.station.exports import ExportOutputs
from gridpush_drake.station.grasping import AddGrasping, AddPusherGate, ExportGrasping, make_grasping_style
from gridpush_drake.station.iiwa import (
    AddIiwaControl,
    Arm,
    ArmControl,
    MakeControlPlant,
    SetArmStart,
)
from gridpush_drake.station.learning import ESTIMATE_OUTPUTS, Learning, make_identifier
from gridpush_drake.station.sensing import AddSensors
from gridpush_drake.station.station_scene import AddStationScene, LoadPushedObject
from gridpush_drake.systems.grasp_command import GraspCommand
from gridpush_drake.systems.grasp_executor import GraspExecutor
from gridpush_drake.systems.planar_pose_sensor import PlanarPoseSensor
from gridpush_drake.systems.push_command import PushCommand
from gridpush_drake.systems.push_executor import PushExecutor, plan_push
from gridpush_drake.systems.push_way import PushingStyle
from gridpush_drake.systems.true_parameters import TrueParameters
from gridpush_drake.systems.weak_calc import NO_SLOTS

HOME = (0.5, 0.0, 0.2)
"""p_WP of the tip at the beginning, m: above the middle of the table, where the arm's posture is comfortable."""

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
    """What a `PushStation` is made from; the first ten are its attributes.

    Attributes:
        scenario, obj, truth, plant, scene_graph, arm, object_in_plant, table, table_top, style: see `PushStation`.
        reach: of the arm.
        control: of the arm.
        camera: sees the object, with noise.
        hidden: remembers the truth.
        grasping: carries out grasps; None where the scene has no gripper.
    """

    scenario: PushScenario
    obj: GridObject
    truth: CellParameters
    plant: MultibodyPlant
    scene_graph: SceneGraph
    arm: Arm
    object_in_plant: GridObjectInPlant
    table: tuple[GeometryId, ...]
    table_top: BaseGeometry
    style: PushingStyle
    reach: ArmReach
    control: ArmControl
    camera: PlanarPoseSensor
    hidden: TrueParameters
    grasping: GraspExecutor | None


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

    - ``push_command``: (6,) see `systems.push_command`.
    - ``executor.status``: abstract `PushStatus`; ``executor.tip_pose``: abstract `RigidTransform`, X_WP desired.
    - ``pusher.state``: (6,) p_WP, m, and v_WP, m/s, of the tip's centre, from the joints.
    - ``object.pose``: (3,) as the camera sees it, m and rad; ``object.pose_true``: as it is, for display and judgement.
    - ``estimate.*``: see `GridIdentifier`; ``iiwa.*``: see Drake's `SimIiwaDriver`; the three after: the plant's own.
    - Where the scene has a gripper: ``grasp_command``: (6,) see `systems.grasp_command`, need not be connected;
      ``grasp.status``: abstract `GraspStatus`; ``gripper.state``: (4,) the fingers' positions, left and right, m, and
      velocities, m/s. ``executor.tip_pose`` is then what push and grasp executor together desire.

    Attributes:
        scenario: what it was made from.
        obj: the object.
        truth: what the plant's object really weighs and how it rubs in a fresh Context, by the scenario's seed.
        plant: the plant.
        scene_graph: of the plant.
        arm: the robot in the plant.
        object_in_plant: the object in the plant.
        table: the table's collision geometries.
        table_top: where on it things may lie, a polygon in W, m.
        style: how the executor pushes.
        gripper: its model instance; None where the scene has none.
    """

    __slots__ = NO_SLOTS

    def __init__(self, builder: DiagramBuilder, parts: StationParts) -> None:
        """Takes over a builder's systems; `MakePushStation` calls it."""
        super().__init__()
        self.scenario, self.obj, self.truth = parts.scenario, parts.obj, parts.truth
        self.plant, self.scene_graph, self.arm = parts.plant, parts.scene_graph, parts.arm
        self.object_in_plant, self.table, self.table_top = parts.object_in_plant, parts.table, parts.table_top
        self.style, self.gripper = parts.style, parts.arm.gripper
        self._grasping, self._reach = parts.grasping, parts.reach
        self._control, self._camera, self._hidden = parts.control, parts.camera, parts.hidden
        builder.BuildInto(self)

    def FindObstacle(self, command: PushCommand) -> str | None:
        """Says why the arm cannot carry out a push, come from its home; None where it can."""
        return plan_push(command, HOME, self.style, self._reach)[1]

    def FindGraspObstacle(self, command: GraspCommand) -> str | None:
        """Says why the arm cannot carry out a grasp, come from its home; None where it can.

        Raises:
            StationError: the scene has no gripper.
        """
        if self._grasping is None:
            raise StationError("the scene has no gripper; expected a model named gripper")
        return self._grasping.plan(command, (*HOME, 0.0))[1] or None

    def SetStart(self, root_context: Context, seed: int | None = None) -> None:
        """Puts arm and object where the scenario has them, at rest. Call it on every fresh Context.

        Args:
            root_context: of the station, or of the Diagram it is part of.
            seed: of the hidden truth and the camera's noise, instead of the scenario's: one Diagram serves many runs.
        """
        SetArmStart(self, root_context, self.plant, self.arm, self._control)
        plant_context = self.plant.GetMyMutableContextFromRoot(root_context)
        SetGridObjectPose(self.plant, plant_context, self.object_in_plant, self.scenario.object_pose)
        if seed is not None:
            truth = MakeTruth(self.obj, self.scenario.truth, seed)
            SetGridObjectParameters(self.plant, self.scene_graph, root_context, self.object_in_plant, truth)
            self._hidden.SetParameters(root_context, truth)
            self._camera.SetSeed(root_context, seed)

    def GetTruth(self, root_context: Context) -> CellParameters:
        """What the plant's object really weighs and how it rubs in a Context, as `SetStart` left it.

        Args:
            root_context: of the station, or of the Diagram it is part of.
        """
        return self._hidden.GetParameters(root_context)

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
    is in the Context; two runs of one station may be interleaved. A station without a gripper that nobody holds any
    more is freed by Python's garbage collector (`gc.collect()`) but for 1 MB or less that stays with Drake; one with a
    gripper in a `PreGraspTask` is not yet freed. Whoever keeps a `RigidBody`, a `Joint`, a `Frame` or the ids of
    `GetCollisionGeometriesForBody` of its plant as a part of the station, or of what it is connected to, keeps all of
    it for good: keep their indices instead.

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
    obj = LoadPushedObject(scenario)
    truth = MakeTruth(obj, scenario.truth, scenario.seed)
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, scenario.simulation.time_step)
    plant.set_name("plant")
    plant.set_stiction_tolerance(scenario.simulation.stiction_tolerance)
    scene_graph.set_name("scene_graph")
    arm, table = AddStationScene(plant, scene_graph, scenario)
    object_in_plant = AddGridObject(
        plant,
        scene_graph,
        obj,
        truth,
        cast(Base, scenario.base),
        table=table,
        height=scenario.object_height,
        visual=show_object,
    )
    skin = find_drake_models() if meshcat is not None else None
    if skin is not None:
        AddSkin(plant, scene_graph, skin)
    plant.Finalize()

    control_plant = MakeControlPlant(gripper=arm.gripper is not None)
    q_start = CalcStartPosture(control_plant, HOME)
    control = AddIiwaControl(builder, plant, arm, control_plant, q_start)
    reach, style = ArmReach(control_plant, q_start), make_style(scenario)
    executor = builder.AddNamedSystem("executor", PushExecutor(HOME, obj.outline, reach, style))
    sensors = AddSensors(builder, plant, scenario, object_in_plant)
    camera, tip = sensors.camera, sensors.tip
    hidden = builder.AddNamedSystem("truth", TrueParameters(truth))
    identifier = builder.AddNamedSystem("identifier", make_identifier(scenario, obj, learning))

    table_top = FindTableOutline(plant, scene_graph.model_inspector())
    grasping = None
    if arm.gripper is not None:
        grasping_style = make_grasping_style(scenario, control_plant)
        grasping = AddGrasping(builder, plant, arm, executor, reach, table_top, grasping_style)
    desired = executor if grasping is None else grasping
    builder.Connect(desired.GetOutputPort("tip_pose"), control.tip_pose)
    for consumer in (executor, identifier):
        builder.Connect(camera.GetOutputPort("object_pose"), consumer.GetInputPort("object_pose"))
    pusher = tip if grasping is None else AddPusherGate(builder, tip, grasping)
    builder.Connect(pusher.GetOutputPort("pusher_state"), identifier.GetInputPort("pusher_state"))
    if meshcat is not None:
        AddMeshcat(builder, scene_graph, meshcat, name)

    builder.ExportInput(executor.GetInputPort("push_command"), "push_command")
    ExportOutputs(builder, executor, "executor", ("status",))
    ExportOutputs(builder, desired, "executor", ("tip_pose",))
    builder.ExportOutput(tip.GetOutputPort("pusher_state"), "pusher.state")
    builder.ExportOutput(camera.GetOutputPort("object_pose"), "object.pose")
    builder.ExportOutput(sensors.eye.GetOutputPort("object_pose"), "object.pose_true")
    ExportOutputs(builder, identifier, "estimate", ESTIMATE_OUTPUTS)
    ExportOutputs(builder, control.driver, "iiwa", IIWA_OUTPUTS)
    builder.ExportOutput(plant.get_body_poses_output_port(), "body_poses")
    builder.ExportOutput(plant.get_contact_results_output_port(), "contact_results")
    builder.ExportOutput(scene_graph.get_query_output_port(), "query_object")
    if grasping is not None:
        ExportGrasping(builder, plant, arm, grasping)
    station = PushStation(
        builder,
        StationParts(
            scenario, obj, truth, plant, scene_graph, arm, object_in_plant, table, table_top, style, reach, control,
            camera, hidden, grasping,
        ),
    )  # fmt: skip
    station.set_name(name)
    return station


def make_style(scenario: PushScenario) -> PushingStyle:
    """How the scenario's finger pushes."""
    finger = scenario.finger
    return PushingStyle(
        travel_height=finger.travel_height, push_height=finger.push_height, tip_radius=finger.tip_radius
    )


def AddMeshcat(
    builder: DiagramBuilder, scene_graph: SceneGraph, meshcat: Meshcat, prefix: str = "station"
) -> MeshcatVisualizer:
    """Shows the illustration geometry, and nothing else, below the path `prefix`."""
    params = MeshcatVisualizerParams(role=Role.kIllustration, prefix=prefix)
    return MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, params)
