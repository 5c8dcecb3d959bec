"""The arm with its finger: it follows straight pushes, within its limits, and says beforehand what it cannot follow."""

import gc

import numpy as np
import pytest

from gridpush_drake.errors import StationError
from gridpush_drake.station.robot.arm import ArmPosture, CalcStartPosture, MakeControlPlant
from gridpush_drake.systems.base.messages import PushCommand
from gridpush_drake.systems.sensing.pusher_state_sensor import ArmTipSensor
from tests.helpers.arm_bench import HOME, ROBOT, ArmBench, add_box

ACCURACY = 1e-3  # m, of the tip's center at every time of a push
CROSS_TRACK = 1e-4  # m
SETTLED = 2e-5  # m, without a load
APPROACH_ACCURACY = 2e-3  # m, between pushes
TILT = np.radians(0.5)
DISTANCE = 0.1  # m

PLACES = [
    (0.45, 0.1, 0.0, 0.05),
    (0.75, 0.0, np.pi, 0.05),
    (0.55, 0.35, -1.6, 0.1),
    (0.4, -0.35, 0.6, 0.1),
    (0.65, -0.3, 1.2, 0.2),
]


@pytest.fixture(scope="module")
def bench():
    return ArmBench()


@pytest.fixture(scope="module")
def posture():
    return ArmPosture(MakeControlPlant(ROBOT), ROBOT)


def calc_errors(record, command):
    """Of the tip while it pushes: timed (T,), m, and across the line (T,), m."""
    pushing = record.array("phase") == "pushing"
    assert pushing.sum() > 50
    error = (record.array("tip") - record.array("desired"))[pushing]
    along = np.array([np.cos(command.direction), np.sin(command.direction), 0.0])
    return np.linalg.norm(error, axis=1), np.linalg.norm(
        error - np.outer(error @ along, along), axis=1
    )


def check_limits(bench, record):
    plant = bench.control_plant
    q, v, torque = record.array("q"), record.array("v"), record.array("torque")
    assert (q > plant.GetPositionLowerLimits()).all()
    assert (q < plant.GetPositionUpperLimits()).all()
    assert (np.abs(v) < plant.GetVelocityUpperLimits()).all()
    assert (np.abs(torque) < plant.GetEffortUpperLimits()).all()
    assert np.abs(v).max() > 0.01
    assert np.abs(torque).max() > 10.0  # gravity alone takes more


@pytest.mark.parametrize(("x", "y", "direction", "speed"), PLACES)
def test_tip_follows_straight_pushes_within_the_arm_s_limits(bench, x, y, direction, speed):
    bench.start()
    command = PushCommand(1, x, y, direction, DISTANCE, speed)
    record = bench.push(command)
    assert bench.status.executed == 1, bench.status
    timed, across = calc_errors(record, command)
    assert timed.max() < ACCURACY
    assert np.percentile(across, 90) < CROSS_TRACK  # the first moments still feel the descent
    error = np.linalg.norm(record.array("tip") - record.array("desired"), axis=1)
    assert error.max() < APPROACH_ACCURACY
    assert error[record.array("phase") == "settling"][-1] < SETTLED
    assert (record.array("down") @ [0, 0, -1]).min() > np.cos(TILT)
    assert not record.contacts
    check_limits(bench, record)


def test_tip_follows_while_it_pushes_a_box():
    """4.4 N of friction: mu_s m g with 1.5 kg and 0.3."""
    bench = ArmBench(time_step=0.002, dress=lambda plant: add_box(plant, 1.5, 0.3))
    command = PushCommand(1, 0.52, 0.0, 0.0, DISTANCE, 0.05)
    record = bench.push(command)
    timed, across = calc_errors(record, command)
    assert timed.max() < ACCURACY
    assert np.percentile(across, 90) < CROSS_TRACK
    assert record.contacts == {("box", "finger_tip"), ("box", "world")}
    check_limits(bench, record)
    box = bench.plant.GetBodyByName("box")
    context = bench.plant.GetMyContextFromRoot(bench.simulator.get_context())
    p_WB = bench.plant.EvalBodyPoseInWorld(context, box).translation()
    moved = (
        record.array("tip")[-1, 0] + 0.008 + 0.05 - 0.6
    )  # the tip's radius, half the box, where it was
    np.testing.assert_allclose(p_WB[:2], [0.6 + moved, 0.0], atol=1e-3)


@pytest.mark.slow
def test_reset_and_reuse_gives_the_same_again(bench):
    runs = []
    for _ in range(2):
        bench.start()
        runs.append(bench.push(PushCommand(1, 0.5, 0.1, 0.3, 0.05, 0.2), every=0.02))
    for name in ("tip", "q", "v", "torque"):
        np.testing.assert_array_equal(runs[0].array(name), runs[1].array(name))


def test_arm_begins_where_it_should_and_holds(bench):
    bench.start()
    record = bench.record(0.01, lambda status: bench.simulator.get_context().get_time() > 0.3)
    np.testing.assert_allclose(
        record.array("tip"), np.broadcast_to(HOME, (len(record.tip), 3)), atol=1e-5
    )
    assert np.abs(record.array("v")).max() < 1e-4
    np.testing.assert_allclose(record.q[-1], bench.q_start, atol=1e-5)


def test_diagram_outlives_the_caller_s_control_plant():
    bench = ArmBench()
    bench.reach = bench.control_plant = None
    bench.executor._reach = None
    gc.collect()
    bench.start()
    bench.push(PushCommand(1, 0.5, 0.1, 0.3, 0.02, 0.2), every=0.05)
    assert bench.status.executed == 1


def test_driver_s_ports_are_those_of_drake_s_stations(bench):
    names = {
        bench.driver.get_output_port(i).get_name() for i in range(bench.driver.num_output_ports())
    }
    assert {
        "position_commanded",
        "position_measured",
        "velocity_estimated",
        "torque_commanded",
    } <= names


def test_start_posture_is_tool_down_at_the_tip(posture):
    for p_WP in (HOME, (0.5, -0.3, 0.1), (0.7, 0.2, 0.15)):
        X_WP = posture.calc_tip_pose(CalcStartPosture(MakeControlPlant(ROBOT), ROBOT, p_WP))
        np.testing.assert_allclose(X_WP.translation(), p_WP, atol=1e-6)
        np.testing.assert_allclose(X_WP.rotation().matrix(), np.diag([-1.0, 1.0, -1.0]), atol=1e-6)


@pytest.mark.parametrize("p_WP", [(1.5, 0.0, 0.2), (0.3, 0.0, 0.2), (0.0, 0.0, 3.0)])
def test_start_out_of_reach_is_refused(p_WP):
    with pytest.raises(StationError, match="does not reach it"):
        CalcStartPosture(MakeControlPlant(ROBOT), ROBOT, p_WP)


def test_moving_arm_comes_to_the_postures_that_reach_predicts(bench, posture):
    """Both are drawn to the nominal posture, so that the way there does not matter."""
    bench.start()
    record = bench.push(PushCommand(1, 0.5, 0.3, -0.5, DISTANCE, 0.1))
    nominal = bench.q_start
    for phase in ("settling", "retracting"):
        k = np.flatnonzero(record.array("phase") == phase)[-1]
        q = posture.solve(record.tip[k], nominal, nominal)
        np.testing.assert_allclose(record.q[k], q, atol=5e-3)


def make_way(x0, y0, x1, y1, low=0.012, high=0.12):
    return [HOME, (x0, y0, high), (x0, y0, low), (x1, y1, low), (x1, y1, high)]


def test_reach_says_what_is_wrong(bench):
    speeds = [0.3, 0.15, 0.05, 0.15]
    assert bench.reach(make_way(0.5, 0.1, 0.6, 0.1), speeds) is None
    assert "does not reach" in bench.reach(make_way(0.75, 0.0, 0.9, 0.0), [0.05] * 4)
    assert "joint 4 of the arm would come to its limit" in bench.reach(
        make_way(0.45, 0.0, 0.35, 0.0), speeds
    )
    assert "would have to turn at" in bench.reach(
        make_way(0.7, 0.2, 0.75, 0.2), [0.1, 0.1, 0.9, 0.1]
    )


@pytest.mark.parametrize(
    ("x", "y", "direction"), [(0.75, 0.0, 0.0), (0.45, 0.0, np.pi)], ids=["stretched", "folded"]
)
def test_arm_fails_where_reach_says_so(bench, x, y, direction):
    """Led there all the same, it leaves the line by more than a millimeter."""
    bench.start()
    command = PushCommand(1, x, y, direction, 0.15, 0.1)
    bench.push(command)
    assert bench.status.refused == 1
    trusting = ArmBench(reach=False)
    record = trusting.push(command)
    assert trusting.status.executed == 1
    assert calc_errors(record, command)[0].max() > 5 * ACCURACY


@pytest.mark.slow
def test_every_random_push_that_is_not_refused_is_followed():
    bench = ArmBench(time_step=0.002)
    rng = np.random.default_rng(5)
    for number in range(1, 41):
        x, y, direction = rng.uniform((0.35, -0.35, -np.pi), (0.75, 0.35, np.pi))
        command = PushCommand(
            number, x, y, direction, DISTANCE, float(rng.choice([0.05, 0.1, 0.2]))
        )
        executed = bench.status.executed
        record = bench.push(command)
        if bench.status.executed == executed:
            continue
        assert calc_errors(record, command)[0].max() < ACCURACY, command
        assert not record.contacts
        check_limits(bench, record)
    assert bench.status.executed > 22


def test_the_tip_is_told_from_the_joints(posture):
    control_plant = MakeControlPlant(ROBOT)
    sensor = ArmTipSensor(control_plant, ROBOT.finger.tip_frame)
    context = sensor.CreateDefaultContext()
    q, v, h = np.array(ROBOT.arm.posture), np.linspace(-0.5, 0.7, 7), 1e-6
    sensor.GetInputPort("position_measured").FixValue(context, q)
    sensor.GetInputPort("velocity_estimated").FixValue(context, v)
    state = sensor.GetOutputPort("pusher_state").Eval(context)
    before, here, after = (posture.calc_tip_pose(q + dt * v).translation() for dt in (-h, 0.0, h))
    np.testing.assert_allclose(state[:3], here, atol=1e-12)
    np.testing.assert_allclose(state[3:], (after - before) / (2 * h), atol=1e-8)


def test_the_force_on_the_tip_is_told_from_the_torques(posture):
    sensor = ArmTipSensor(MakeControlPlant(ROBOT), ROBOT.finger.tip_frame)
    context = sensor.CreateDefaultContext()
    q, force, h = np.array(ROBOT.arm.posture), np.array([3.0, -4.0, 12.0]), 1e-6
    steps = h * np.eye(7)
    J = np.transpose([
        (posture.calc_tip_pose(q + dq).translation() - posture.calc_tip_pose(q - dq).translation()) / (2 * h)
        for dq in steps
    ])  # fmt: skip
    sensor.GetInputPort("position_measured").FixValue(context, q)
    sensor.GetInputPort("torque_external").FixValue(context, J.T @ force)
    np.testing.assert_allclose(sensor.GetOutputPort("force").Eval(context), force, atol=1e-6)
