"""The gripper in simulation, moved by Drake's own controller."""

import numpy as np
import pytest
from pydrake.geometry import Box, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    ExternallyAppliedSpatialForce,
)
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from gridpush_drake.multibody.parser import MakeParser, find_models
from gridpush_drake.planning.pregrasp.grasp.gripper import PadLimit
from gridpush_drake.station.control.grasping import AddGripperController
from gridpush_drake.station.robot.measures import GripperMeasures, read_measures
from gridpush_drake.systems.execution.grasp_trajectory import CONTROLLER_STIFFNESS

CLOSING_DOWN = RigidTransform(RollPitchYaw(-np.pi / 2, np.pi / 2, 0.0), [0.0, 0.0, 0.0])
"""X_WB of the gripper's body: fingers forward, closing vertically, as the bracket holds it."""

each_gripper = pytest.mark.parametrize("name", ["wsg_50", "strong"])

BAR = Box(0.2, 0.03, 0.03)


def read_gripper(name):
    return read_measures(find_models() / f"grippers/{name}/gripper.yaml", GripperMeasures)


class Grip:
    """A gripper fixed to the world, its controller, and perhaps a bar between the pads."""

    def __init__(self, name="wsg_50", bar_mass=None, X_WB=CLOSING_DOWN, shape=BAR):
        builder = DiagramBuilder()
        self.max_force = read_gripper(name).max_force
        self.plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.002)
        self.inspector = scene_graph.model_inspector()
        MakeParser(self.plant).AddModelsFromUrl(
            f"package://gridpush_drake/grippers/{name}/{name}.urdf"
        )
        self.gripper = self.plant.GetModelInstanceByName("gripper")
        self.plant.WeldFrames(self.plant.world_frame(), self.plant.GetFrameByName("body"), X_WB)
        if bar_mass is not None:
            inertia = SpatialInertia.SolidBoxWithMass(bar_mass, *shape.size())
            self.bar = self.plant.AddRigidBody("bar", self.plant.AddModelInstance("bar"), inertia)
            self.plant.RegisterCollisionGeometry(
                self.bar, RigidTransform(), shape, "bar", CoulombFriction(0.5, 0.5)
            )
        self.plant.Finalize()
        controller = AddGripperController(builder, self.plant, self.gripper, read_gripper(name))
        self.opening = builder.AddSystem(ConstantVectorSource([0.1]))
        force = builder.AddSystem(ConstantVectorSource([self.max_force]))
        builder.Connect(
            self.opening.get_output_port(), controller.get_desired_position_input_port()
        )
        builder.Connect(force.get_output_port(), controller.get_force_limit_input_port())
        self.simulator = Simulator(builder.Build())
        self.context = self.simulator.get_mutable_context()
        self.plant_context = self.plant.GetMyMutableContextFromRoot(self.context)
        self.plant.SetPositions(self.plant_context, self.gripper, [-0.05, 0.05])

    def move(self, opening, seconds):
        source = self.opening.GetMyMutableContextFromRoot(self.context)
        self.opening.get_mutable_source_value(source).SetFromVector([opening])
        self.simulator.AdvanceTo(self.context.get_time() + seconds)

    def squeeze(self, seconds):
        """With the whole force; what is more than 80 N bit by bit, or fingers of 50 g strike the bar out of place.

        At an opening of 0 the controller would hold a bar by 6 N only.
        """
        for force in np.arange(80.0, self.max_force, 15.0):
            self.move(-force / CONTROLLER_STIFFNESS, 0.05)
        self.hold(seconds)

    def hold(self, seconds):
        """With the whole force as before."""
        self.move(-self.max_force / CONTROLLER_STIFFNESS, seconds)

    @property
    def position(self):
        return self.plant.GetPositions(self.plant_context, self.gripper)


@each_gripper
def test_joints_are_those_that_drakes_controller_moves(name):
    plant = Grip(name).plant
    joints = [plant.GetJointByName(f"{side}_finger_sliding_joint") for side in ("left", "right")]
    assert [joint.child_body().name() for joint in joints] == ["left_finger", "right_finger"]
    assert [joint.position_lower_limit() for joint in joints] == [-0.055, 0.0]
    assert [joint.position_upper_limit() for joint in joints] == [0.0, 0.055]
    efforts = [
        plant.get_joint_actuator(index).effort_limit() for index in plant.GetJointActuatorIndices()
    ]
    assert efforts == 2 * [read_gripper(name).max_force]
    assert [joint.position_start() for joint in joints] == [
        0,
        1,
    ]  # the order that Drake's controller reads


@each_gripper
def test_it_opens_and_closes_to_what_is_asked(name):
    grip = Grip(
        name, X_WB=RigidTransform()
    )  # closing level: gravity does not hold either finger back
    for opening in (0.1, 0.03, 0.0, 0.08):
        grip.move(opening, 1.0)
        assert grip.position == pytest.approx([-opening / 2, opening / 2], abs=1e-4)


@each_gripper
def test_pads_meet_when_closed(name):
    """Inner faces of the spheres, and of the visible pads, lie at the middle at position 0, off it by the position."""
    grip = Grip(name)
    for side, sign in (("left", -1), ("right", 1)):
        body = grip.plant.GetBodyByName(f"{side}_finger")
        grip.plant.SetPositions(grip.plant_context, grip.gripper, [-0.02, 0.02])
        X_BF = body.EvalPoseInWorld(grip.plant_context)
        p_B = (CLOSING_DOWN.inverse() @ X_BF).multiply(np.array([-0.0085 - 0.003, 0.026, 0.0]))
        assert p_B == pytest.approx([sign * 0.02, 0.103133, 0.0], abs=1e-9)


@each_gripper
def test_pads_are_where_the_measures_say(name):
    """The spheres at their corners, which meet in the middle at position 0, are about the grasp frame."""
    grip, measures = Grip(name), read_gripper(name)
    grip.plant.SetPositions(grip.plant_context, grip.gripper, [-0.02, 0.02])
    X_GW = grip.plant.GetFrameByName("grasp").CalcPoseInWorld(grip.plant_context).inverse()
    inspector = grip.inspector
    for side, sign in (("left", -1), ("right", 1)):
        body = grip.plant.GetBodyByName(f"{side}_finger")
        X_GF = X_GW @ body.EvalPoseInWorld(grip.plant_context)
        corners = []
        for geometry in grip.plant.GetCollisionGeometriesForBody(body):
            shape = inspector.GetShape(geometry)
            if isinstance(shape, Sphere):
                x, y, z = (X_GF @ inspector.GetPoseInFrame(geometry)).translation()
                assert x - sign * shape.radius() == pytest.approx(sign * 0.02, abs=1e-9)
                corners.append([y, z])
        along, across = np.transpose(corners)
        assert sorted(along) == pytest.approx(
            measures.pad_length / 2 * np.array([-1, -1, 1, 1]), abs=1e-9
        )
        assert sorted(across) == pytest.approx(across.max() * np.array([-1, -1, 1, 1]), abs=1e-9)
        assert 0 <= across.max() - measures.pad_width / 2 + 1e-9 <= 1.1e-3, (
            "the measure is on the safe side"
        )


@each_gripper
def test_it_holds_a_bar_that_hangs_out_to_one_side(name):
    """0.7 kg, gripped 8 cm from its middle: it stays between the pads for 3 s and hardly turns.

    The controller's spring between the fingers' middle and the body's, 2000 N/m of the WSG 50,
    gives way by 2 mm.
    """
    grip = Grip(name, bar_mass=0.7)
    p_WG = grip.plant.GetFrameByName("grasp").CalcPoseInWorld(grip.plant_context).translation()
    forward = CLOSING_DOWN.rotation().matrix()[:, 1]
    start = RigidTransform(p_WG + 0.08 * forward)
    grip.plant.SetFreeBodyPose(grip.plant_context, grip.bar, start)
    grip.plant.SetPositions(grip.plant_context, grip.gripper, [-0.0155, 0.0155])
    grip.squeeze(3.0)
    X_WB = grip.bar.EvalPoseInWorld(grip.plant_context)
    turned = (start.rotation().inverse() @ X_WB.rotation()).ToAngleAxis().angle()
    assert np.degrees(turned) < 0.5
    assert np.linalg.norm(X_WB.translation() - start.translation()) < 0.003
    assert np.diff(grip.position) == pytest.approx(0.03, abs=1e-3)


def calc_tilt(name, mass, d_x, d_y):
    """Of a plate gripped where its middle is d_x further along the fingers and d_y across, degrees.

    As when it is lifted off a table, what bears it goes bit by bit.
    """
    grip = Grip(name, bar_mass=mass, shape=Box(0.2, 0.3, 0.03))
    p_WG = grip.plant.GetFrameByName("grasp").CalcPoseInWorld(grip.plant_context).translation()
    forward, up = CLOSING_DOWN.rotation().matrix()[:, 1], np.array([0.0, 0.0, 1.0])
    start = RigidTransform(p_WG + d_x * forward + d_y * np.cross(up, forward))
    grip.plant.SetFreeBodyPose(grip.plant_context, grip.bar, start)
    grip.plant.SetPositions(grip.plant_context, grip.gripper, [-0.015, 0.015])
    support = ExternallyAppliedSpatialForce()
    support.body_index = grip.bar.index()
    grasp = grip.squeeze
    for borne in np.linspace(1.0, 0.0, 30):
        support.F_Bq_W = SpatialForce(np.zeros(3), borne * mass * 9.81 * up)
        grip.plant.get_applied_spatial_force_input_port().FixValue(grip.plant_context, [support])
        grasp(0.05)
        grasp = grip.hold
    grip.hold(1.0)
    return np.degrees(
        np.arccos(grip.bar.EvalPoseInWorld(grip.plant_context).rotation().matrix()[2, 2])
    )


@pytest.mark.parametrize(
    ("name", "d_x", "d_y"),
    [
        ("wsg_50", 0.05, 0.0),
        ("wsg_50", 0.0, 0.07),
        ("wsg_50", 0.08, 0.04),
        ("strong", 0.08, 0.04),
    ],
)
def test_a_plate_is_held_as_far_as_the_pads_limit_says_and_no_further(name, d_x, d_y):
    measures = read_gripper(name)
    pads = PadLimit(measures.make_gripper(), measures.max_force, weight=1.0)
    (fraction,) = pads.calc_fractions(
        np.zeros((1, 2)), np.zeros(1), np.array([[d_x, d_y]])
    )  # of each newton
    limit = 1.0 / fraction / 9.81
    assert (
        calc_tilt(name, 0.95 * limit, d_x, d_y) < 0.5 * measures.max_force / 80.0
    )  # the plate's surface gives way
    assert calc_tilt(name, 2.5 * limit, d_x, d_y) > 10.0


def test_the_bracket_lets_it_close_vertically_with_the_right_finger_below():
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.002)
    MakeParser(plant).AddModels(str(find_models() / "scenes/iiwa_grasp.dmd.yaml"))
    plant.Finalize()
    context = plant.CreateDefaultContext()
    X_WG = plant.GetFrameByName("grasp").CalcPoseInWorld(context)
    left, right, tip = (
        plant.GetBodyByName(name).EvalPoseInWorld(context).translation()
        for name in ("left_finger", "right_finger", "finger_tip")
    )
    assert X_WG.rotation().matrix()[:, 0] == pytest.approx([0, 0, -1], abs=1e-9)
    assert abs(X_WG.rotation().matrix()[2, 1]) < 1e-9
    assert left[2] - right[2] == pytest.approx(2 * (0.05 + 0.0115), abs=1e-9)
    assert right[2] - tip[2] > 0.1
