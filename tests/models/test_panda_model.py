"""The Panda of primitives: figures and kinematics as published; its hand opens as Drake's gripper controller has it."""

from math import pi

import numpy as np
import pytest
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.multibody.parser import MakeParser

URL = "package://gridpush_drake/robots/panda/panda_primitives.urdf"
HAND = "package://gridpush_drake/grippers/panda_hand/panda_hand.urdf"

# a (m), d (m) and alpha (rad) in Craig's convention; least and greatest position (rad), speed
# (rad/s), torque (N m)
JOINTS = [
    (0.0, 0.333, 0.0, -2.8973, 2.8973, 2.175, 87),
    (0.0, 0.0, -pi / 2, -1.7628, 1.7628, 2.175, 87),
    (0.0, 0.316, pi / 2, -2.8973, 2.8973, 2.175, 87),
    (0.0825, 0.0, pi / 2, -3.0718, -0.0698, 2.175, 87),
    (-0.0825, 0.384, -pi / 2, -2.8973, 2.8973, 2.61, 12),
    (0.0, 0.0, pi / 2, -0.0175, 3.7525, 2.61, 12),
    (0.088, 0.0, pi / 2, -2.8973, 2.8973, 2.61, 12),
]
FLANGE = 0.107
TOTAL_MASS = 18.0

READY = (0, -pi / 4, 0, -3 * pi / 4, 0, pi / 2, pi / 4)


class Model:
    def __init__(self, url, base):
        builder = DiagramBuilder()
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
        (self.instance,) = MakeParser(self.plant).AddModelsFromUrl(url)
        self.plant.WeldFrames(self.plant.world_frame(), self.plant.GetFrameByName(base))
        self.plant.Finalize()
        self.diagram = builder.Build()
        self.root = self.diagram.CreateDefaultContext()
        self.context = self.plant.GetMyContextFromRoot(self.root)

    def touches_itself(self):
        query = self.scene_graph.get_query_output_port().Eval(
            self.scene_graph.GetMyContextFromRoot(self.root)
        )
        return query.HasCollisions()


@pytest.fixture(scope="module")
def panda():
    return Model(URL, "panda_link0")


def calc_flange(q):
    """(4, 4) of the flange by the Denavit-Hartenberg parameters."""
    X = np.eye(4)
    for angle, (a, d, alpha, *_) in zip(q, JOINTS, strict=True):
        c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(alpha), np.sin(alpha)
        X = X @ [
            [c, -s, 0, a],
            [s * ca, c * ca, -sa, -d * sa],
            [s * sa, c * sa, ca, d * ca],
            [0, 0, 0, 1],
        ]
    return X @ [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, FLANGE], [0, 0, 0, 1]]


def test_kinematics_are_the_published_parameters(panda):
    lower, upper = np.array(JOINTS)[:, 3:5].T
    for q in np.random.default_rng(3).uniform(lower, upper, (20, 7)):
        panda.plant.SetPositions(panda.context, q)
        got = (
            panda.plant.GetFrameByName("panda_link8").CalcPoseInWorld(panda.context).GetAsMatrix4()
        )
        np.testing.assert_allclose(got, calc_flange(q), atol=1e-12)


def test_limits_are_the_published_ones_and_names_those_of_drake_models(panda):
    plant = panda.plant
    for k, (*_, least, greatest, speed, torque) in enumerate(JOINTS, 1):
        joint = plant.GetJointByName(f"panda_joint{k}")
        assert (joint.position_lower_limit(), joint.position_upper_limit()) == (least, greatest)
        assert (joint.velocity_lower_limit(), joint.velocity_upper_limit()) == (-speed, speed)
        assert plant.GetJointActuatorByName(f"panda_motor{k}").effort_limit() == torque
        assert joint.child_body().name() == f"panda_link{k}"
    assert plant.num_positions() == plant.num_actuators() == 7
    assert plant.CalcTotalMass(panda.context) == pytest.approx(TOTAL_MASS, rel=0.01)


@pytest.mark.parametrize(
    "q", [READY, (0, -0.44, 0, -2.29, 0, 1.85, 0.79), (1, 0.5, 0.3, -1.2, 0.4, 2.0, -1)]
)
def test_arm_does_not_touch_itself_in_sensible_postures(panda, q):
    panda.plant.SetPositions(panda.context, q)
    assert not panda.touches_itself()


def test_hand_opens_to_8_cm_and_its_pads_meet_when_closed():
    hand = Model(HAND, "panda_hand")
    plant = hand.plant
    joints = [plant.GetJointByName(f"panda_finger_joint{k}") for k in (1, 2)]
    assert [joint.position_lower_limit() for joint in joints] == [-0.04, 0.0]
    assert [joint.position_upper_limit() for joint in joints] == [0.0, 0.04]
    assert [joint.position_start() for joint in joints] == [
        0,
        1,
    ]  # the order that Drake's controller reads
    X_HG = plant.GetFrameByName("panda_hand_tcp").CalcPoseInWorld(hand.context)
    assert X_HG.translation() == pytest.approx([0.0, 0.0, 0.1034])
    query = hand.scene_graph.get_query_output_port()
    corner = X_HG.translation() + [
        0.0075,
        0.0,
        0.008,
    ]  # between the spheres at one corner of the pads
    for opening in (0.0, 0.03, 0.08):
        plant.SetPositions(hand.context, [-opening / 2, opening / 2])
        inspected = query.Eval(hand.scene_graph.GetMyContextFromRoot(hand.root))
        near = sorted(each.distance for each in inspected.ComputeSignedDistanceToPoint(corner))
        assert near[:2] == pytest.approx([opening / 2, opening / 2], abs=1e-9)
