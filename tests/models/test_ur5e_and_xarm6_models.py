"""The UR5e and the xArm 6 of primitives: kinematics and limits as their makers publish them."""

from math import atan2, hypot, pi

import numpy as np
import pytest

from tests.models.test_panda_model import Model

# theta's offset (rad), d (m), a (m), alpha (rad) in the standard convention
UR5E = [
    (0.0, 0.1625, 0.0, pi / 2),
    (0.0, 0.0, -0.425, 0.0),
    (0.0, 0.0, -0.3922, 0.0),
    (0.0, 0.1333, 0.0, pi / 2),
    (0.0, 0.0997, 0.0, -pi / 2),
    (0.0, 0.0996, 0.0, 0.0),
]
BEND = atan2(0.2845, 0.0535)
XARM6 = [
    (0.0, 0.267, 0.0, -pi / 2),
    (-BEND, 0.0, hypot(0.0535, 0.2845), 0.0),
    (BEND, 0.0, 0.0775, -pi / 2),
    (0.0, 0.3425, 0.0, pi / 2),
    (0.0, 0.0, 0.076, -pi / 2),
    (0.0, 0.097, 0.0, 0.0),
]
TURN = 2 * pi

# least and greatest position (rad), speed (rad/s), torque (N m)
UR5E_LIMITS = {
    "shoulder_pan_joint": (-TURN, TURN, pi, 150),
    "shoulder_lift_joint": (-TURN, TURN, pi, 150),
    "elbow_joint": (-pi, pi, pi, 150),
    "wrist_1_joint": (-TURN, TURN, pi, 28),
    "wrist_2_joint": (-TURN, TURN, pi, 28),
    "wrist_3_joint": (-TURN, TURN, pi, 28),
}
XARM6_LIMITS = {
    "joint1": (-TURN, TURN, 3.14, 50),
    "joint2": (-2.059, 2.0944, 3.14, 50),
    "joint3": (-3.927, 0.19198, 3.14, 32),
    "joint4": (-TURN, TURN, 3.14, 32),
    "joint5": (-1.69297, pi, 3.14, 32),
    "joint6": (-TURN, TURN, 3.14, 20),
}

ARMS = {
    "ur5e": ("base_link", "tool0", UR5E, UR5E_LIMITS, 21.7),
    "xarm6": ("link_base", "link_eef", XARM6, XARM6_LIMITS, 10.45),
}


@pytest.fixture(scope="module", params=ARMS)
def arm(request):
    name = request.param
    base, *_ = ARMS[name]
    url = f"package://gridpush_drake/robots/{name}/{name}_primitives.urdf"
    return name, Model(url, base)


def calc_flange(parameters, q):
    """(4, 4) of the flange by the Denavit-Hartenberg parameters."""
    X = np.eye(4)
    for angle, (offset, d, a, alpha) in zip(q, parameters, strict=True):
        theta = angle + offset
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        X = X @ [
            [c, -s * ca, s * sa, a * c],
            [s, c * ca, -c * sa, a * s],
            [0, sa, ca, d],
            [0, 0, 0, 1],
        ]
    return X


def test_kinematics_are_the_published_parameters(arm):
    name, model = arm
    _, flange, parameters, limits, _ = ARMS[name]
    # the maker's base frame of a UR is ROS's base_link, turned by half a turn
    X_WD = np.diag([-1.0, -1.0, 1.0, 1.0]) if name == "ur5e" else np.eye(4)
    lower, upper = np.array(list(limits.values()))[:, :2].T
    for q in np.random.default_rng(3).uniform(lower, upper, (20, 6)):
        model.plant.SetPositions(model.context, q)
        frame = model.plant.GetFrameByName(flange)
        got = frame.CalcPoseInWorld(model.context).GetAsMatrix4()
        np.testing.assert_allclose(got, X_WD @ calc_flange(parameters, q), atol=1e-9)


def test_limits_are_the_published_ones_and_names_those_of_the_ros_drivers(arm):
    name, model = arm
    *_, limits, mass = ARMS[name]
    plant = model.plant
    for k, (joint_name, (least, greatest, speed, _)) in enumerate(limits.items()):
        joint = plant.GetJointByName(joint_name)
        assert joint.position_start() == k
        assert joint.position_lower_limit() == pytest.approx(least)
        assert joint.position_upper_limit() == pytest.approx(greatest)
        assert joint.velocity_upper_limit() == pytest.approx(speed)
    efforts = [plant.get_joint_actuator(i).effort_limit() for i in plant.GetJointActuatorIndices()]
    assert efforts == [limit[3] for limit in limits.values()]
    assert plant.num_positions() == plant.num_actuators() == 6
    assert plant.CalcTotalMass(model.context) == pytest.approx(mass, rel=0.01)


POSTURES = {
    "ur5e": [
        (0, -pi / 2, 0, -pi / 2, 0, 0),
        (-0.32, -1.75, 2.06, -1.89, -1.57, 1.25),
        (0.5, -1.2, 1.4, -1.8, -1.57, 0.3),
    ],
    "xarm6": [
        (0, 0, 0, 0, 0, 0),
        (0, -0.16, -0.9, 0, 1.06, 0),
        (0.7, 0.3, -1.6, 0.4, 1.3, -1.0),
    ],
}


def test_arm_does_not_touch_itself_in_sensible_postures(arm):
    name, model = arm
    for q in POSTURES[name]:
        model.plant.SetPositions(model.context, q)
        assert not model.touches_itself(), q
