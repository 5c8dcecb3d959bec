"""The iiwa of primitives: figures, kinematics and dynamics as published, shapes as promised."""

from math import pi

import numpy as np
import pytest
from pydrake.geometry import Role
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.multibody.parser import MakeParser

URL = "package://gridpush_drake/robots/iiwa14/iiwa14_primitives.urdf"

# rpy and xyz of a joint in its parent's frame (rad, m), limit (rad), speed (rad/s), effort (N m),
# gear
JOINTS = [
    ((0, 0, 0), (0, 0, 0.1575), 2.96705972839, 1.48352986, 320, 160),
    ((pi / 2, 0, pi), (0, 0, 0.2025), 2.09439510239, 1.48352986, 320, 160),
    ((pi / 2, 0, pi), (0, 0.2045, 0), 2.96705972839, 1.74532925, 176, 160),
    ((pi / 2, 0, 0), (0, 0, 0.2155), 2.09439510239, 1.30899694, 176, 160),
    ((-pi / 2, pi, 0), (0, 0.1845, 0), 2.96705972839, 2.26892803, 110, 100),
    ((pi / 2, 0, 0), (0, 0, 0.2155), 2.09439510239, 2.35619449, 40, 160),
    ((-pi / 2, pi, 0), (0, 0.081, 0), 3.05432619099, 2.35619449, 40, 160),
]
ROTORS = [1.321e-4] * 5 + [4.54e-5] * 2
FLANGE = 0.045

# mass (kg), center (m), moments about it (kg m²)
LINKS = [
    (5.0, (-0.1, 0, 0.07), (0.05, 0.06, 0.03)),
    (5.76, (0, -0.03, 0.12), (0.033, 0.0333, 0.0123)),
    (6.35, (0.0003, 0.059, 0.042), (0.0305, 0.011, 0.0304)),
    (3.5, (0, 0.03, 0.13), (0.025, 0.0238, 0.0076)),
    (3.5, (0, 0.067, 0.034), (0.017, 0.006, 0.0164)),
    (3.5, (0.0001, 0.021, 0.076), (0.01, 0.0087, 0.00449)),
    (1.8, (0, 0.0006, 0.0004), (0.0049, 0.0047, 0.0036)),
    (1.2, (0, 0, 0.02), (0.001, 0.001, 0.001)),
]


class Iiwa:
    def __init__(self):
        builder = DiagramBuilder()
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
        (self.instance,) = MakeParser(self.plant).AddModelsFromUrl(URL)
        self.plant.WeldFrames(self.plant.world_frame(), self.plant.GetFrameByName("iiwa_link_0"))
        self.plant.Finalize()
        self.diagram = builder.Build()
        self.root = self.diagram.CreateDefaultContext()
        self.context = self.plant.GetMyContextFromRoot(self.root)


@pytest.fixture(scope="module")
def iiwa():
    return Iiwa()


def rotate(axis, angle):
    c, s = np.cos(angle), np.sin(angle)
    R = np.eye(3)
    i, j = [k for k in range(3) if k != axis]
    sign = -1.0 if axis == 1 else 1.0
    R[i, i], R[j, j], R[i, j], R[j, i] = c, c, -sign * s, sign * s
    return R


def make_transform(R, p):
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R, p
    return X


def calc_links(q):
    """(8, 4, 4) poses of the links from the table alone."""
    X = [np.eye(4)]
    for angle, ((roll, pitch, yaw), xyz, *_) in zip(q, JOINTS, strict=True):
        R = rotate(2, yaw) @ rotate(1, pitch) @ rotate(0, roll)
        X.append(X[-1] @ make_transform(R, xyz) @ make_transform(rotate(2, angle), (0, 0, 0)))
    return X


def draw_postures(count):
    limits = np.array([joint[2] for joint in JOINTS])
    return np.random.default_rng(7).uniform(-limits, limits, (count, 7))


def test_names_are_those_of_drake_models(iiwa):
    plant = iiwa.plant
    assert plant.GetModelInstanceName(iiwa.instance) == "iiwa14"
    bodies = [plant.get_body(index).name() for index in plant.GetBodyIndices(iiwa.instance)]
    assert bodies == [f"iiwa_link_{i}" for i in range(8)] + ["iiwa_link_ee_kuka"]
    names = [plant.get_joint(index).name() for index in plant.GetJointIndices(iiwa.instance)]
    assert [name for name in names if "joint" in name] == [
        f"iiwa_joint_{k}" for k in range(1, 8)
    ] + ["iiwa_joint_ee"]
    assert plant.num_positions(iiwa.instance) == plant.num_actuators(iiwa.instance) == 7


def test_masses_and_inertias(iiwa):
    for i, (mass, center, moments) in enumerate(LINKS):
        M = iiwa.plant.GetBodyByName(f"iiwa_link_{i}").default_spatial_inertia()
        assert M.get_mass() == mass
        np.testing.assert_allclose(M.get_com(), center)
        about_center = M.Shift(M.get_com()).CalcRotationalInertia()
        np.testing.assert_allclose(about_center.get_moments(), moments, atol=1e-14)
        np.testing.assert_allclose(about_center.get_products(), 0.0, atol=1e-14)


def test_limits_damping_and_gears(iiwa):
    plant = iiwa.plant
    for k, ((*_, limit, speed, effort, gear), rotor) in enumerate(
        zip(JOINTS, ROTORS, strict=True), 1
    ):
        joint, actuator = (
            plant.GetJointByName(f"iiwa_joint_{k}"),
            plant.GetJointActuatorByName(f"iiwa_joint_{k}"),
        )
        assert (joint.position_lower_limit(), joint.position_upper_limit()) == (-limit, limit)
        assert (joint.velocity_lower_limit(), joint.velocity_upper_limit()) == (-speed, speed)
        assert joint.default_damping() == 0.5
        assert actuator.effort_limit() == effort
        assert (actuator.default_rotor_inertia(), actuator.default_gear_ratio()) == (rotor, gear)


def test_forward_kinematics_is_that_of_the_table(iiwa):
    for q in draw_postures(20):
        iiwa.plant.SetPositions(iiwa.context, q)
        links = calc_links(q)
        flange = links[-1] @ make_transform(np.eye(3), (0, 0, FLANGE))
        for name, X in [
            *((f"iiwa_link_{i}", X) for i, X in enumerate(links)),
            ("iiwa_link_ee_kuka", flange),
        ]:
            got = iiwa.plant.GetFrameByName(name).CalcPoseInWorld(iiwa.context).GetAsMatrix4()
            np.testing.assert_allclose(got, X, atol=1e-13, err_msg=name)


def test_mass_matrix_is_that_of_the_table(iiwa):
    """M = sum of m Jv' Jv + Jw' I Jw over the links, plus the rotors' reflected inertia on the diagonal."""
    for q in draw_postures(10):
        links = calc_links(q)
        axes, origins = [X[:3, 2] for X in links[1:]], [X[:3, 3] for X in links[1:]]
        M = np.diag([rotor * joint[5] ** 2 for rotor, joint in zip(ROTORS, JOINTS, strict=True)])
        for i, (mass, center, moments) in enumerate(LINKS[1:], 1):
            R, p = links[i][:3, :3], links[i][:3] @ [*center, 1.0]
            Jv, Jw = np.zeros((3, 7)), np.zeros((3, 7))
            for k in range(i):
                Jv[:, k], Jw[:, k] = np.cross(axes[k], p - origins[k]), axes[k]
            M += mass * Jv.T @ Jv + Jw.T @ R @ np.diag(moments) @ R.T @ Jw
        iiwa.plant.SetPositions(iiwa.context, q)
        got = iiwa.plant.CalcMassMatrix(iiwa.context)
        np.testing.assert_allclose(got, M, atol=1e-12)
        np.testing.assert_allclose(got, got.T, atol=1e-12)
        assert np.linalg.eigvalsh(got).min() > 0.1


def test_every_visible_shape_has_a_color(iiwa):
    inspector = iiwa.scene_graph.model_inspector()
    for i in range(8):
        for visual in iiwa.plant.GetVisualGeometriesForBody(
            iiwa.plant.GetBodyByName(f"iiwa_link_{i}")
        ):
            assert inspector.GetProperties(visual, Role.kIllustration).HasProperty(
                "phong", "diffuse"
            )


@pytest.mark.parametrize(
    "q", [np.zeros(7), (0, 0.6, 0, -1.75, 0, 1.0, 0), (1, 1, 0.3, -1.9, 0.4, 1.3, -1)]
)
def test_arm_does_not_touch_itself_in_sensible_postures(iiwa, q):
    iiwa.plant.SetPositions(iiwa.context, q)
    query = iiwa.scene_graph.get_query_output_port().Eval(
        iiwa.scene_graph.GetMyContextFromRoot(iiwa.root)
    )
    assert not query.HasCollisions()
