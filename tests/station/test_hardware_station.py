import numpy as np
import pytest
from drake import lcmt_iiwa_status, lcmt_planar_manipuland_status
from pydrake.lcm import DrakeLcm
from pydrake.multibody.parsing import AddDirectives, ModelDirective

from gridpush_drake.errors import StationError
from gridpush_drake.multibody.parser import find_models
from gridpush_drake.planning.scene.separation import WANTED_CLEARANCE
from gridpush_drake.station import IdentifyTask, MakePushStation, PushScenario, TaskStatus
from gridpush_drake.station.hardware.hardware_link import HardwareLink
from gridpush_drake.station.hardware.hardware_station import MakeHardwareStation, make_limits
from gridpush_drake.station.links.lcm.lcm_address import open_lcm
from gridpush_drake.station.links.lcm.lcm_link import LcmLink
from gridpush_drake.station.links.lcm.lcm_messages import (
    ARM_MESSAGES,
    OBJECT_STATUS,
    name_object_channel,
)
from gridpush_drake.station.links.link import ARM_PERIOD, LinkRole
from gridpush_drake.station.robot.arm import ArmPosture
from gridpush_drake.station.robot.robot import find_robot, make_robot_directives
from gridpush_drake.station.schema.scenario import PartTruth
from gridpush_drake.station.schema.scenario_file import read_scenario
from gridpush_drake.station.tasks.scene_task import SeparateTask
from gridpush_drake.systems.base.messages import GraspCommand, PushPhase
from gridpush_drake.systems.safety.guard_status import GuardMode
from tests.helpers.twin_bench import TwinBench, make_book_scenario

MIN_SPEED = 0.05
"""rad/s of a joint in the middle of a push."""

ARM = ARM_MESSAGES["iiwa"]

ROBOT = find_robot(PushScenario().directives)

STOPS_WITHIN = 0.1
"""s of the robot's time after a fault."""

RETREATS_WITHIN = 0.4
"""s of the robot's time after a collision, in which the arm also goes back slowly."""

NEAR = 1e-3
"""rad, of a joint that is where it is held."""


@pytest.fixture(scope="module")
def bench():
    return TwinBench(make_book_scenario(), IdentifyTask)


def test_it_has_the_ports_of_the_simulated_station_but_for_what_nobody_knows(bench):
    def list_ports(system):
        inputs = {system.get_input_port(i).get_name() for i in range(system.num_input_ports())}
        return inputs, {
            system.get_output_port(i).get_name() for i in range(system.num_output_ports())
        }

    simulated, real = (
        list_ports(MakePushStation(make_book_scenario())),
        list_ports(bench.task.station),
    )
    assert real[0] - simulated[0] == {"stop", "arm_status", "object.observation"}
    assert real[1] - simulated[1] == {"guard.status", "guard.position", "pusher.force"}
    assert simulated[0] <= real[0]
    assert simulated[1] - real[1] == {
        "object.pose_true",
        "body_poses",
        "contact_results",
        "query_object",
    }


@pytest.fixture(scope="module")
def finished(bench):
    """A run in which nothing goes wrong, and what its link reported."""
    bench.begin()
    return (
        bench.task.run(drive=bench.link),
        list(bench.link.report.events),
        dict(bench.link.report.left_out),
    )


def test_a_task_over_lcm_ends_as_in_simulation(bench, finished):
    record, events, left_out = finished
    assert (record.status, record.truth, len(record.log)) == (TaskStatus.FINISHED, None, 1), (
        record.message
    )
    assert record.limit_report.ok
    assert record.limit_report.tracking_error < 0.003  # at 80 mm/s, three periods late
    assert bench.link.report.pauses == 0
    assert left_out == {}
    # the object is truly where the robot saw it come to rest
    twin, truth = bench.twin, bench.twin.world.object_in_plant
    poses = twin.world.plant.get_body_poses_output_port().Eval(
        twin.world.plant.GetMyContextFromRoot(bench.simulator.get_context())
    )
    place = poses[int(truth.body.index())].translation()[:2]
    np.testing.assert_allclose(record.log[0].final_pose[:2], place, atol=0.003)
    assert np.linalg.norm(place - [0.55, 0.0]) > 0.02
    # it ended at rest, and every command that went out kept the limits
    assert bench.link.armed is False
    assert [text for _, text in events] == ["guard following", "guard holding: the work is done"]


def make_status(data, **changed):
    message = lcmt_iiwa_status.decode(data)
    for name, value in changed.items():
        setattr(message, name, value)
    return message.encode()


class Fault:
    """Spoils a channel from 0.35 s after a push begins."""

    def __init__(self, bench, channel, spoil):
        self.bench, self.spoil, self.begun, self.since, self.last = (
            bench,
            spoil,
            None,
            bench.time,
            b"",
        )
        bench.spoil[channel] = self

    def __call__(self, time, data):
        if self.begun is None:
            phase = self.bench.task.read("executor.status").phase
            self.since = time if phase != PushPhase.PUSHING else self.since
            if time - self.since < 0.35:
                self.last = data
                return [data]
            self.begun = time
        return self.spoil(self, time, data)


def freeze(fault, time, data):
    return [fault.last]


def vanish(fault, time, data):
    return []


def push_back(fault, time, data):
    message = lcmt_iiwa_status.decode(data)
    return [make_status(data, joint_torque_external=[40.0, *message.joint_torque_external[1:]])]


def jump(fault, time, data):
    message = lcmt_planar_manipuland_status.decode(data)
    message.position = [message.position[0], message.position[1] + 0.1]
    return [message.encode()]


def freeze_joints(fault, time, data):
    last = lcmt_iiwa_status.decode(fault.last)
    return [make_status(data, joint_position_measured=last.joint_position_measured)]


def turn_joints_once(fault, time, data):
    """A bit error, or the status of another robot, in one status; with a torque over its limit."""
    if time > fault.begun:
        return [data]
    message = lcmt_iiwa_status.decode(data)
    joints = (np.array(message.joint_position_measured) + 1.5).tolist()
    torque = [40.0, *message.joint_torque_external[1:]]
    return [make_status(data, joint_position_measured=joints, joint_torque_external=torque)]


def turn_a_joint_once(fault, time, data):
    if time > fault.begun:
        return [data]
    message = lcmt_iiwa_status.decode(data)
    joints = [message.joint_position_measured[0] + 0.3, *message.joint_position_measured[1:]]
    return [make_status(data, joint_position_measured=joints)]


def creep(fault, time, data):
    """29 mm at every look, just below what counts as a jump."""
    message = lcmt_planar_manipuland_status.decode(data)
    looks = round((time - fault.begun) * PushScenario().camera.rate) + 1
    message.position = [message.position[0], message.position[1] + 0.029 * looks]
    return [message.encode()]


def press_tip_once(fault, time, data):
    """40 N from below on the finger's tip, in one status; every joint's torque is within its limit."""
    if time > fault.begun:
        return [data]
    world = fault.bench.twin.world
    posture = ArmPosture(world.setting.control_plant, ROBOT)
    q, step = np.array(lcmt_iiwa_status.decode(data).joint_position_measured), 1e-6
    heights = [posture.calc_tip_pose(q + step * e).translation()[2] for e in np.eye(len(q))]
    slope = (np.array(heights) - posture.calc_tip_pose(q).translation()[2]) / step
    torque = 40.0 * slope  # of the force f at the tip: J' f
    limits = make_limits(world.setting.scenario, world.setting.control_plant).torque
    assert (np.abs(torque) < 0.9 * limits).all()
    return [make_status(data, joint_torque_external=torque.tolist())]


COLLIDES = (push_back, turn_joints_once, press_tip_once)
"""Faults after which the arm goes back."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("channel", "spoil", "says"),
    [
        (ARM.status, freeze, "No usable status of the robot came for 1.00 s"),
        (ARM.status, vanish, "the robot has sent no status for longer than the 50 ms"),
        (ARM.status, push_back, "the external torque on joint 1 is 40.0 N m; 32.0 N m are allowed"),
        (OBJECT_STATUS, jump, "the object was seen to jump by "),
        (ARM.status, freeze_joints, "no joint's measured position has changed for "),
        (ARM.status, turn_joints_once, "the external torque on joint 1 is 40.0 N m"),
        (ARM.status, press_tip_once, "the force on the finger's tip is 40.0 N; 30.0 N are allowed"),
        (ARM.status, turn_a_joint_once, "joint 1 was measured to move at "),
        (OBJECT_STATUS, creep, "the object was seen to move by "),
    ],
)
def test_a_fault_in_the_middle_of_a_push_stops_the_arm_and_holds_it(bench, channel, spoil, says):
    bench.begin()
    fault = Fault(bench, channel, spoil)
    record = bench.task.run(drive=bench.link)
    assert record.status == TaskStatus.STOPPED
    assert says in record.message
    assert any(says in text for _, text in bench.link.report.events)
    speed = max(
        np.abs(v).max() for time, _, v in bench.rows if 0 < fault.begun - time < STOPS_WITHIN
    )
    assert speed > MIN_SPEED
    for _ in range(100):
        bench.move()
    stop = bench.find_stop(fault.begun, NEAR)
    print(f"{spoil.__name__}: at rest {1e3 * stop:.0f} ms after the fault")
    assert stop < {freeze_joints: 0.4, creep: 0.4}.get(
        spoil, RETREATS_WITHIN if spoil in COLLIDES else STOPS_WITHIN
    )
    # wherever the status said that the arm is, it went back by 10 mm at most, and slowly
    after = np.array([q for time, q, _ in bench.rows if time >= fault.begun])
    posture = ArmPosture(bench.twin.world.setting.control_plant, ROBOT)
    tips = np.array([posture.calc_tip_pose(q).translation() for q in after])
    farthest = np.linalg.norm(tips - tips[0], axis=1).max()
    assert farthest < (0.014 if spoil in COLLIDES else 0.4 * make_book_scenario().pokes.speed)
    assert np.abs([v for time, _, v in bench.rows if time > fault.begun]).max() < 0.6
    # the object is not thrown: it comes to rest where the finger does
    assert np.isfinite(bench.task.read("object.pose")).all()


@pytest.mark.slow
def test_a_robot_that_pauses_is_waited_for(bench, finished):
    """As a twin does whose computer is busy: its clock stands still, too."""
    bench.begin()
    begun, advance, before = [], bench.link.advance, bench.link.report.silences

    def pause(simulator, time):
        if not begun and bench.task.read("executor.status").phase == PushPhase.PUSHING:
            begun.append(bench.time)
            bench.paused = 100
        advance(simulator, time)

    bench.link.advance = pause
    try:
        record = bench.task.run(drive=bench.link)
    finally:
        del bench.link.advance
    assert record.status == TaskStatus.FINISHED, record.message
    np.testing.assert_allclose(record.log[0].final_pose, finished[0].log[0].final_pose, atol=0.003)
    told = [text for _, text in bench.link.report.events]
    assert any("the robot stood still for 500 ms, by its own clock, too" in text for text in told)
    assert bench.link.report.silences == before + 1
    assert begun


@pytest.mark.slow
def test_a_blocked_finger_stops_the_arm_which_then_presses_no_more_and_begins_again():
    scenario = make_book_scenario()
    scenario.truth.parts = [
        PartTruth(label=label, cell_mass=20.0) for label in (1, 2)
    ]  # no arm moves that
    scenario.safety.torque_share = 1.0
    blocked = TwinBench(scenario, IdentifyTask)
    blocked.begin()
    record = blocked.task.run(drive=blocked.link)
    assert record.status == TaskStatus.STOPPED
    assert "the force on the finger's tip is " in record.message
    assert "30.0 N are allowed" in record.message
    noticed = (
        blocked.time
        - blocked.task.simulator.get_context().get_time()
        + blocked.task.read("guard.status").since
    )
    for _ in range(100):
        blocked.move()
    stop = blocked.find_stop(noticed, NEAR)
    pressed, presses = blocked.link.report.force, blocked.calc_force()
    print(f"at rest {1e3 * stop:.0f} ms after 30 N; at most {pressed:.0f} N, then {presses:.0f} N")
    assert stop < RETREATS_WITHIN
    assert 30.0 < pressed < 100.0
    assert presses < 15.0
    blocked.link.armed = True
    again = blocked.task.run(drive=blocked.link)  # it goes up from there, and to the same push
    assert again.status == TaskStatus.STOPPED
    assert again.duration > 1.0


def run_until_pushing(bench, seconds=0.35):
    """Begins a run, and breaks it off so long after a push began."""
    bench.task.begin(drive=bench.link)
    simulator, since = bench.task.simulator, np.inf
    simulator.Initialize()
    while bench.time < since + seconds:
        bench.link.advance(simulator, simulator.get_context().get_time() + ARM_PERIOD)
        if bench.task.read("executor.status").phase == PushPhase.PUSHING:
            since = min(since, bench.time)


@pytest.mark.parametrize("name", ["bench", pytest.param("panda", marks=pytest.mark.slow)])
def test_where_the_controller_dies_the_robot_comes_to_rest_smoothly(name, request):
    bench = request.getfixturevalue(name)
    bench.begin()
    run_until_pushing(bench)
    fault = bench.time
    for _ in range(100):
        bench.move()
    driver = bench.twin.GetOutputPort("driver.status").Eval(bench.simulator.get_context())
    assert (driver.mode, driver.reason) == (
        GuardMode.HOLDING,
        "no command has come for 10 ms; 10 ms are allowed",
    )
    speed = np.array([v for time, _, v in bench.rows if time > fault - 0.1])
    stop = bench.find_stop(fault, NEAR)
    print(f"at rest {1e3 * stop:.0f} ms after the last command")
    assert np.abs(speed[:10]).max() > MIN_SPEED
    assert stop < STOPS_WITHIN
    assert (
        np.abs(np.diff(speed, axis=0)).max() / ARM_PERIOD
        < 2 * bench.task.station.scenario.safety.acceleration
    )


@pytest.mark.slow
def test_commands_that_are_doubled_lost_or_overtaken_change_little(bench, finished):
    bench.begin()
    sent = []

    def disturb(data):
        sent.append(data)
        k = len(sent)
        if k % 10 == 3:
            return []
        return [data, data] if k % 10 == 5 else [data, sent[-3]] if k % 10 == 8 else [data]

    bench.disturb = disturb
    record = bench.task.run(drive=bench.link)
    assert record.status == TaskStatus.FINISHED, record.message
    np.testing.assert_allclose(record.log[0].final_pose, finished[0].log[0].final_pose, atol=0.002)


@pytest.mark.slow
def test_doubled_late_and_broken_messages_are_left_out_and_change_nothing(bench, finished):
    expected = finished[0].log[0].final_pose
    bench.begin()
    old = []

    def double(time, data):
        old.append(data)
        return [data, data, old[max(len(old) - 4, 0)], data[:-3], make_status(data, num_joints=0)]

    bench.spoil[ARM.status] = double
    record = bench.task.run(drive=bench.link)
    assert record.status == TaskStatus.FINISHED, record.message
    np.testing.assert_allclose(record.log[0].final_pose, expected, atol=0.002)
    left_out = bench.link.report.left_out
    assert any("not newer" in why for why in left_out)
    assert any("is not lcmt_iiwa_status" in why for why in left_out)


def test_where_the_arm_may_not_begin_it_says_what_it_needs(bench):
    bench.begin()
    q = bench.rows[-1][1]
    for change, says in (([0, 0, 0, 0, 0, 0.5, 0], "degrees from where it points down"),
                         ([1.5, 0, 0, 0, 0, 0, -1.5], "bring the arm's joints to about")):  # fmt: skip
        bench.spoil[ARM.status] = lambda time, data, change=change: [
            make_status(data, joint_position_measured=(q + change).tolist())
        ]
        bench.move()
        with pytest.raises(StationError, match=says):
            bench.task.run(drive=bench.link)


def test_nothing_goes_out_before_it_is_armed(bench):
    bench.begin()
    bench.link.armed = False
    sent = []
    bench.lcm.Subscribe(ARM.command, sent.append)
    push = bench.task.preview(bench.link, within=5.0)
    assert push is not None and push.command_id == 1
    bench.lcm.HandleSubscriptions(0)
    assert sent == []
    assert bench.find_stop(bench.rows[0][0], NEAR) == 0.0


def make_panda_scenario():
    scenario = make_book_scenario()
    scenario.directives = make_robot_directives("panda", grasping=False)
    return scenario


@pytest.fixture(scope="module")
def panda():
    return TwinBench(make_panda_scenario(), IdentifyTask)


@pytest.mark.slow
def test_a_panda_speaks_messages_of_its_own_and_stops_as_fast(panda):
    assert (panda.messages.status, panda.messages.command) == ("PANDA_STATUS", "PANDA_COMMAND")
    panda.begin()
    record = panda.task.run(drive=panda.link)
    assert (record.status, len(record.log)) == (TaskStatus.FINISHED, 1), record.message
    assert record.limit_report.ok
    assert panda.link.report.left_out == {}
    panda.begin()
    fault = Fault(panda, panda.messages.status, vanish)
    assert panda.task.run(drive=panda.link).status == TaskStatus.STOPPED
    stop = panda.find_stop(fault.begun, NEAR)
    print(f"at rest {1e3 * stop:.0f} ms after the last status")
    assert stop < STOPS_WITHIN


def test_a_robot_whose_messages_nobody_knows_is_refused():
    scenes = {
        "gantry_push": "robot.yaml of gantry has no messages",
        "panda_grasp": "the hand of a panda has no LCM message",
    }
    for scene, says in scenes.items():
        file = f"package://gridpush_drake/scenes/{scene}.dmd.yaml"
        robot = find_robot([ModelDirective(add_directives=AddDirectives(file=file))])
        with pytest.raises(StationError, match=says):
            LcmLink(DrakeLcm("memq://"), robot, LinkRole.CONTROL)


def test_a_silent_or_another_robot_is_refused():
    lcm = DrakeLcm("memq://")
    link = HardwareLink(LcmLink(lcm, ROBOT, LinkRole.CONTROL), ROBOT)
    with pytest.raises(
        StationError, match=r"the robot sends no status on IIWA_STATUS within 0\.1 s"
    ):
        link.wait(patience=0.1)
    message = lcmt_iiwa_status()
    message.utime, message.num_joints = 1, 6
    for name in lcmt_iiwa_status.__slots__[2:]:
        setattr(message, name, [0.0] * 6)
    lcm.Publish(ARM.status, message.encode())
    with pytest.raises(StationError, match="IIWA_STATUS speaks of 6 joints; expected 7"):
        link.wait(patience=0.1)


@pytest.mark.parametrize(
    "url",
    ["nonsense", "udpm://10.0.0.1:7667", "udpm://239.255.76.67:99999", "udpm://239.1.1.300:1"],
)
def test_a_wrong_url_is_refused(url):
    with pytest.raises(StationError, match="expected udpm://ADDRESS:PORT"):
        open_lcm(url)


def test_no_path_is_planned_on_which_the_guard_would_stop_the_arm():
    """The same grasp is refused where the tip would leave the guard's bounds, by a sentence that names them."""
    scenario = read_scenario(find_models() / "scenarios/grasp.yaml")
    grasp = GraspCommand(1, 0.5, 0.18, 0.015, -np.pi / 2, 0.1)
    said = []
    for margin in (scenario.safety.margin, 0.02):
        scenario.safety.margin = margin
        station = MakeHardwareStation(scenario)
        said.append(station.FindGraspObstacle(grasp))
    assert said[0] is None
    assert said[1].startswith("the finger's tip is at (") and "y -0.47 to 0.37 m" in said[1]


def make_two():
    """Two objects of which the second is 21 mm from the first: one push away from done."""
    objects = [
        {"object": "pliers", "pose": [0.56, -0.1, 0.0]},
        {"object": "open_book", "pose": [0.56, 0.068, 0.0]},
    ]
    scenario = PushScenario(objects=objects, seed=4)
    scenario.pokes.speed = 0.08
    return scenario


@pytest.fixture(scope="module")
def bench_of_two():
    return TwinBench(make_two(), SeparateTask)


def test_the_poses_of_several_objects_come_over_lcm(bench_of_two):
    bench = bench_of_two
    bench.begin()
    task = bench.task
    push = task.preview(bench.link, within=2.0)
    assert task.read("object.pose") == pytest.approx([0.56, -0.1, 0.0], abs=0.01)
    assert task.read("other_0.pose") == pytest.approx([0.56, 0.068, 0.0], abs=0.01)
    assert push is not None and push.distance > 0.003
    # each object has a truth of its own in the twin, drawn from the scenario's seed
    plant = bench.twin.world.plant
    context = plant.GetMyContextFromRoot(bench.simulator.get_context())
    parts = [bench.twin.world.object_in_plant, bench.twin.world.setting.others[0].part]
    middles = [part.body.CalcSpatialInertiaInBodyFrame(context).get_com()[:2] for part in parts]
    even = [part.obj.p_BC.mean(axis=0) for part in parts]
    assert (np.linalg.norm(np.subtract(middles, even), axis=1) > 1e-3).all()


def test_an_object_of_which_nobody_tells_is_named():
    lcm = DrakeLcm("memq://")
    edge = LcmLink(lcm, ROBOT, LinkRole.CONTROL, others=2)
    link = HardwareLink(edge, ROBOT, others=("objects[0]", "objects[2]"))
    lcm.Publish(ARM.status, bytes_of_status())
    now = lcmt_planar_manipuland_status()
    now.utime = 10_000_000
    for number in (0, 1):
        lcm.Publish(name_object_channel(number), now.encode())
    with pytest.raises(
        StationError, match=r"nobody says where objects\[2\] is on .*_OTHER_1 within"
    ):
        link.wait(patience=0.1)


def bytes_of_status():
    message = lcmt_iiwa_status()
    message.utime, message.num_joints = 10_000_000, 7
    for name in ("measured", "commanded", "ipo"):
        setattr(message, f"joint_position_{name}", [0.1] * 7)
    message.joint_velocity_estimated = [0.0] * 7
    for name in ("measured", "commanded", "external"):
        setattr(message, f"joint_torque_{name}", [0.0] * 7)
    return message.encode()


@pytest.mark.slow
def test_objects_are_separated_over_lcm(bench_of_two):
    bench = bench_of_two
    bench.begin()
    record = bench.task.run(drive=bench.link)
    assert record.status == TaskStatus.REACHED, record.message
    assert record.pushes >= 1 and len(record.scene_log) == record.pushes
    assert bench.link.report.events[-1][1] == "guard holding: the work is done"
    assert bench.link.report.left_out == {}
    assert record.clearances.min() > WANTED_CLEARANCE - 0.003
    # the objects are truly where the robot saw them come to rest
    plant = bench.twin.world.plant
    poses = plant.get_body_poses_output_port().Eval(
        plant.GetMyContextFromRoot(bench.simulator.get_context())
    )
    parts = [bench.twin.world.object_in_plant, bench.twin.world.setting.others[0].part]
    places = [poses[int(part.body_index)].translation()[:2] for part in parts]
    np.testing.assert_allclose(record.poses[:, :2], places, atol=0.003)
