"""What an arm feels, how it presses and how it weighs what it lifts: each system by itself."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator

from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.weighing.press import PressOutcome, PressTarget
from gridpush_drake.pushes.weighings import MassTestLog, TiltTest
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.tasks.pregrasp_kind import PreGraspKind
from gridpush_drake.systems.base.messages import (
    GraspCommand,
    GraspPhase,
    GraspStatus,
    PressCommand,
    PushStatus,
)
from gridpush_drake.systems.execution.press_executor import PressExecutor
from gridpush_drake.systems.sensing.arm_load_sensor import ArmLoadSensor, LoadNoise
from gridpush_drake.systems.sensing.lift_scale import LiftOptions, LiftScale
from tests.helpers.shapes import rectangle

BAR = GridObject.from_outline(rectangle(0.3, 0.06), max_cells=60, name="bar")
POSE = (0.0, 0.0, 0.0)
TARGET = PressTarget((0.12, 0.0), (0.08, 0.0), 0.0, 0.03, 0.008)


@pytest.fixture(scope="module")
def robot():
    resolved = resolve(PreGraspKind().make_scenario())
    return resolved.robot, resolved.control_plant, resolved.q_start


def feel(robot, frame, wrench, noise=None, seed=0, time=0.0):
    """What the sensor tells of a wrench (torque above force) on the origin of a frame."""
    measures, plant, q = robot
    sensor = ArmLoadSensor(
        plant, measures.finger.tip_frame, measures.gripper.grasp_frame, noise=noise, seed=seed
    )
    context = sensor.CreateDefaultContext()
    # By virtual work: tau = J^T w, with J from differences of the frame's pose.
    scratch = plant.CreateDefaultContext()
    step = 1e-6
    columns = []
    for k in range(len(q)):
        X = []
        for sign in (1.0, -1.0):
            moved = np.array(q)
            moved[k] += sign * step
            plant.SetPositions(scratch, moved)
            X.append(plant.GetFrameByName(frame).CalcPoseInWorld(scratch))
        turn = (X[0].rotation() @ X[1].rotation().inverse()).ToAngleAxis()
        columns.append(
            np.concatenate([turn.angle() * turn.axis(), X[0].translation() - X[1].translation()])
            / (2 * step)
        )
    sensor.GetInputPort("position_measured").FixValue(context, q)
    sensor.GetInputPort("torque_external").FixValue(context, np.array(columns) @ wrench)
    simulator = Simulator(sensor, context)
    samples = []
    for count in range(round(time / 0.005) + 1):
        simulator.AdvanceTo(count * 0.005 + 1e-4)
        samples.append(
            np.concatenate(
                [
                    sensor.GetOutputPort("tip_force").Eval(simulator.get_context()),
                    sensor.GetOutputPort("grasp_wrench").Eval(simulator.get_context()),
                    sensor.GetOutputPort("smooth_tip_force").Eval(simulator.get_context()),
                ]
            )
        )
    return np.array(samples)


def test_an_arm_feels_the_force_on_its_tip_and_the_load_in_its_gripper(robot):
    force = np.array([1.0, -2.0, 8.0])
    tip = feel(robot, robot[0].finger.tip_frame, np.array([0.0, 0.0, 0.0, *force]))
    np.testing.assert_allclose(tip[0, :3], force, atol=1e-5)
    load = np.array([0.3, -0.2, 0.0, 0.0, 0.0, -6.0])
    grasp = feel(robot, robot[0].gripper.grasp_frame, load)
    np.testing.assert_allclose(grasp[0, 3:9], load, atol=1e-5)


def test_the_noise_is_as_large_as_is_said_and_depends_on_the_seed_alone(robot):
    noise = LoadNoise(force=0.2, torque=0.02, force_offset=0.5, torque_offset=0.05)
    frame = robot[0].finger.tip_frame
    one, same, other = (feel(robot, frame, np.zeros(6), noise, seed, 1.5) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    stds = one.std(axis=0)
    np.testing.assert_allclose(stds[:3], 0.2, rtol=0.2)
    np.testing.assert_allclose(stds[3:6], 0.02, rtol=0.2)
    np.testing.assert_allclose(stds[6:9], 0.2, rtol=0.2)
    # A running average over 6 samples leaves 0.2 N sqrt(5 ms / (2 x 30 ms)), about its own mean.
    np.testing.assert_allclose(one[60:, 9:].std(axis=0), 0.2 * np.sqrt(1 / 12), rtol=0.35)
    np.testing.assert_allclose(one[60:, 9:].mean(axis=0), one[60:, :3].mean(axis=0), atol=0.02)
    # The offset stays the same within a run and differs from run to run.
    assert np.abs(one.mean(axis=0) - other.mean(axis=0)).max() > 0.1


def test_the_smooth_force_follows_the_force_and_begins_anew_after_what_is_not_finite(robot):
    measures, plant, q = robot
    sensor = ArmLoadSensor(plant, measures.finger.tip_frame)
    context = sensor.CreateDefaultContext()
    sensor.GetInputPort("position_measured").FixValue(context, q)
    simulator = Simulator(sensor, context)

    def feel_torque(size, until):
        torque = np.full(len(q), size)
        sensor.GetInputPort("torque_external").FixValue(simulator.get_mutable_context(), torque)
        simulator.AdvanceTo(until)
        ports = (sensor.GetOutputPort(name) for name in ("tip_force", "smooth_tip_force"))
        return [np.array(port.Eval(simulator.get_context())) for port in ports]

    # The first sample is taken as it is; a change arrives with a time constant of 30 ms.
    force, smooth = feel_torque(1.0, 0.0001)
    np.testing.assert_array_equal(force, smooth)
    twice, smooth = feel_torque(2.0, 0.0301)
    np.testing.assert_allclose(twice, 2 * force)
    np.testing.assert_allclose(smooth, force * (2 - np.exp(-1)), rtol=1e-9)
    assert np.isnan(feel_torque(np.nan, 0.0351)).all()
    three, smooth = feel_torque(3.0, 0.0401)
    np.testing.assert_array_equal(three, smooth)


class Presser:
    """An executor of presses whose inputs are set."""

    def __init__(self, reach=None):
        self.system = PressExecutor(BAR, reach)
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self.fix("object_pose", POSE)
        self.fix("pusher_state", np.zeros(6))
        self.fix("force", np.zeros(3))
        self.fix("push_status", AbstractValue.Make(PushStatus()))
        rest = RigidTransform([0.0, 0.1, 0.12])
        self.fix("other_tip_pose", AbstractValue.Make(rest))

    def fix(self, port, value):
        self.system.GetInputPort(port).FixValue(self.context, value)

    def read(self, port):
        return self.system.GetOutputPort(port).Eval(self.context)

    def ask(self, number, **changes):
        command = replace(PressCommand.from_target(number, TARGET, POSE), **changes)
        self.fix("press_command", command.to_vector())
        self.simulator.AdvanceTo(self.context.get_time() + 0.02)
        return self.read("status")

    def follow(self, longest):
        """Lets the tip be where it is commanded to be."""
        end = self.context.get_time() + longest
        while self.context.get_time() < end:
            self.simulator.AdvanceTo(self.context.get_time() + 0.005)
            place = self.read("tip_pose").translation()
            self.fix("pusher_state", np.concatenate([place, np.zeros(3)]))
            if self.read("status").step == "pressing":
                break
        return self.read("status")


def test_presses_that_make_no_sense_are_refused_with_a_reason():
    presser = Presser()
    for number, (changes, reason) in enumerate(
        [
            ({"x": np.nan}, "not finite"),
            ({"x": 0.05}, "inside the table's edge, at (0.050, 0.000) m"),
            ({"y": 0.05}, "beside the object, at (0.120, 0.050) m"),
            ({"top": 0.2}, "top is 0.200 m high; expected more than 0 and less than 0."),
        ],
        start=1,
    ):
        status = presser.ask(number, **changes)
        assert status.outcome == PressOutcome.REFUSED
        assert reason in status.reason
        assert status.ready
    stuck = Presser(lambda path, speeds: "the arm does not reach it")
    assert stuck.ask(1).reason == "the arm does not reach it"


def test_an_object_that_is_seen_to_move_away_is_let_go():
    presser = Presser()
    assert presser.ask(1).step == "approaching"
    assert presser.follow(5.0).step == "pressing"
    # Nothing has touched it yet: a smaller motion than that of an object that is pressed is enough.
    presser.fix("object_pose", (0.004, 0.0, 0.0))
    presser.simulator.AdvanceTo(presser.context.get_time() + 0.01)
    presser.fix("object_pose", POSE)
    end = presser.context.get_time() + 6.0
    while presser.context.get_time() < end and not presser.read("status").ready:
        presser.follow(0.05)
    status = presser.read("status")
    assert (status.step, status.outcome) == ("idle", PressOutcome.MOVED)
    assert status.reason == "the object was seen to move away"
    # The pose of the other executors is passed on again.
    np.testing.assert_allclose(presser.read("tip_pose").translation(), [0.0, 0.1, 0.12], atol=1e-9)


@pytest.mark.parametrize(
    ("after", "weighed"),
    [
        ((0.0005, 0.0, np.radians(0.1)), True),
        ((0.0, 0.0, np.radians(0.4)), False),
        ((0.002, 0.0, 0.0), False),
        ((np.nan, np.nan, np.nan), True),
    ],
    ids=["at_rest", "turned", "shifted", "not_seen_again"],
)
def test_a_press_by_which_the_object_slid_weighs_nothing(after, weighed):
    presser = Presser()
    presser.ask(1)
    assert presser.follow(5.0).step == "pressing"
    # The object lies still up to 4 N, and then gives way.
    height = TARGET.hover[2]
    stiffness = 4000.0
    for _ in range(2000):
        presser.simulator.AdvanceTo(presser.context.get_time() + 0.005)
        status = presser.read("status")
        if status.step != "pressing":
            break
        place = presser.read("tip_pose").translation().copy()
        force = min(stiffness * max(height - place[2], 0.0), 4.0)
        place[2] += force / stiffness
        presser.fix("pusher_state", np.concatenate([place, np.zeros(3)]))
        presser.fix("force", [0.0, 0.0, force])
    assert status.step == "returning"
    presser.fix("object_pose", after)
    presser.simulator.AdvanceTo(presser.context.get_time() + 6.0)
    status = presser.read("status")
    assert status.ready
    assert status.weighed == weighed
    assert len(presser.read("weighing_log")) == weighed
    assert status.outcome == (PressOutcome.TILTED if weighed else PressOutcome.SLID)
    assert weighed or "the object slid by" in status.reason


def test_a_lifted_object_is_weighed_by_what_is_felt_beyond_the_empty_gripper():
    scale = LiftScale(LiftOptions(settle=0.2, time=0.5))
    simulator = Simulator(scale)
    context = simulator.get_mutable_context()

    def fix(port, value):
        scale.GetInputPort(port).FixValue(context, value)

    press = TiltTest(np.zeros(3), np.array([0.1, 0.0]), 3.0, np.array([0.05, 0.0]), 0.0)
    fix("weighing_log", AbstractValue.Make(MassTestLog((press,))))
    command = GraspCommand(1, x=0.5, y=0.2, z=0.015, approach=-1.5, lift=0.1)
    fix("grasp_command", command.to_vector())
    offset = np.array([0.05, -0.02, 0.01, 0.4, -0.3, 0.6])
    weight, center = 6.0, np.array([0.52, 0.15])
    l_x, l_y = center - command.p_WG[:2]
    load = np.array([-weight * l_y, weight * l_x, 0.0, 0.0, 0.0, -weight])
    for phase, pose, wrench, seconds in (
        (GraspPhase.APPROACHING, (0.45, 0.1, 0.3), offset, 0.1),
        (GraspPhase.ENTERING, (0.45, 0.1, 0.3), offset, 0.3),
        # While it is gripped and lifted, what the camera sees does not count.
        (GraspPhase.LIFTING, (9.0, 9.0, 9.0), offset + 3.0, 0.3),
        (GraspPhase.HOLDING, (9.0, 9.0, 9.0), offset + load, 1.0),
    ):
        fix("grasp_status", AbstractValue.Make(GraspStatus(phase, 1)))
        fix("object_pose", pose)
        fix("grasp_wrench", wrench)
        simulator.AdvanceTo(context.get_time() + seconds)
    log = scale.GetOutputPort("weighing_log").Eval(context)
    assert [one.force for one in log.presses] == [press.force]
    (lift,) = log.lifts
    assert lift.weight == pytest.approx(weight, abs=1e-9)
    np.testing.assert_allclose(lift.torque, load[:2], atol=1e-9)
    np.testing.assert_allclose(lift.pose, (0.45, 0.1, 0.3), atol=1e-12)
    np.testing.assert_allclose(lift.place, (0.5, 0.2))
    assert 0.05 < lift.weight_std < 0.1
    assert 0.01 < lift.torque_std < 0.02
