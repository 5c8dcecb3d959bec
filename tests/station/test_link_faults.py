"""Single faults of messages, clocks and of the controller itself, each once in the whole twin."""

import math
from functools import partial

import numpy as np
import pytest
from drake import lcmt_iiwa_command, lcmt_iiwa_status, lcmt_planar_manipuland_status

from gridpush_drake.cli.run import robot as robot_command
from gridpush_drake.station import IdentifyTask, PushScenario, TaskStatus
from gridpush_drake.station.hardware import hardware_link
from gridpush_drake.station.links.in_process import InProcessLink
from gridpush_drake.station.links.lcm.lcm_messages import ARM_MESSAGES, OBJECT_STATUS
from gridpush_drake.station.links.link import ARM_PERIOD
from gridpush_drake.station.robot.arm import ArmPosture
from gridpush_drake.station.robot.robot import find_robot
from gridpush_drake.station.tasks.registry import TASK_KINDS
from gridpush_drake.systems.base.messages import PushPhase
from gridpush_drake.systems.safety import guard_status
from gridpush_drake.systems.safety.guard_status import GuardStatus, StopKind
from tests.helpers.twin_bench import TwinBench, make_book_scenario

ARM = ARM_MESSAGES["iiwa"]

STOPS_WITHIN = 0.1
"""s of the robot's time after a fault."""

NEAR = 1e-3
"""rad, of a joint that is where it is held."""

PATIENCE = 1.2
"""s, for braking, and for being measured at rest, beside a way back."""

FAR = 4e9
"""us, by which a clock jumps."""


@pytest.fixture(scope="module")
def bench():
    return TwinBench(make_book_scenario(), IdentifyTask)


class Fault:
    """Spoils a channel's messages from 0.35 s after a push begins: `count` of them, or all."""

    def __init__(self, bench, channel, spoil, count=math.inf):
        self.bench, self.spoil, self.count = bench, spoil, count
        self.begun, self.since = None, bench.time
        bench.spoil[channel] = self

    def __call__(self, time, data):
        if self.begun is None:
            if self.bench.task.read("executor.status").phase != PushPhase.PUSHING:
                self.since = time
            if time - self.since < 0.35:
                return [data]
            self.begun = time
        if self.count <= 0:
            return [data]
        self.count -= 1
        return [self.spoil(data)]


def change_status(data, **changed):
    message = lcmt_iiwa_status.decode(data)
    for name, value in changed.items():
        setattr(message, name, value(getattr(message, name)))
    return message.encode()


def change_pose(data, **changed):
    message = lcmt_planar_manipuland_status.decode(data)
    for name, value in changed.items():
        setattr(message, name, value(getattr(message, name)))
    return message.encode()


def spoil_number(value, number=math.nan):
    return [*value[:2], number, *value[3:]]


SPOILED = {
    "joints": partial(change_status, joint_position_measured=spoil_number),
    "velocities": partial(change_status, joint_velocity_estimated=spoil_number),
    "torques": partial(change_status, joint_torque_external=partial(spoil_number, number=math.inf)),
    "huge": partial(change_status, joint_position_measured=partial(spoil_number, number=1e300)),
    "longer": lambda data: data + b"more",
    "shorter": lambda data: data[:-1],
    "future": partial(change_status, utime=lambda utime: utime + int(FAR)),
    "past": partial(change_status, utime=lambda utime: utime - int(2e6)),
}
"""A status of the arm that cannot be used."""


def run(bench):
    """Runs the task; returns its record, and the positions that were commanded."""
    sent = []
    bench.disturb = lambda data: [sent.append(lcmt_iiwa_command.decode(data).joint_position), data][
        1:
    ]
    record = bench.task.run(drive=bench.link)
    bench.lcm.HandleSubscriptions(0)  # the last command is still under way
    return record, np.array(sent)


BETWEEN = 10
"""Number of statuses from one that is spoiled to the next: 50 ms."""


class InTurn:
    """Spoils one status after another, in each way once, with good ones between them."""

    def __init__(self, ways):
        self.left, self.count = list(ways), 0

    def __call__(self, data):
        self.count += 1
        return self.left.pop(0)(data) if self.left and self.count % BETWEEN == 0 else data


def put_in_future(data):
    return change_pose(data, utime=lambda utime: utime + int(FAR))


FROM_FUTURE = f"{OBJECT_STATUS} is from the future, by the robot's clock"
"""Why a pose is left out."""


def watch_unseen(bench):
    """When the object was not seen, s of the bench's time; noted while `bench.link.advance` is it."""
    times = []
    advance = bench.link.advance

    def watch(simulator, time):
        advance(simulator, time)
        if not np.isfinite(bench.task.read("object.pose")).all():
            times.append(bench.time)

    bench.link.advance = watch
    return times


def test_single_messages_that_cannot_be_used_are_left_out_and_the_work_goes_on(bench):
    bench.begin()
    spoil = InTurn(SPOILED.values())
    Fault(bench, ARM.status, spoil)
    fault = Fault(bench, OBJECT_STATUS, put_in_future, count=1)
    unseen = watch_unseen(bench)
    try:
        record, _ = run(bench)
    finally:
        del bench.link.advance
    assert record.status == TaskStatus.FINISHED, record.message
    assert spoil.left == [] and fault.count == 0
    left_out = bench.link.report.left_out
    assert left_out[FROM_FUTURE] >= 1
    assert sum(left_out.values()) == len(SPOILED) + left_out[FROM_FUTURE], left_out
    assert not [time for time in unseen if time > fault.begun]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["joints", "shorter"])
def test_where_no_status_can_be_used_any_more_the_arm_is_stopped_and_it_is_said_why(bench, name):
    bench.begin()
    fault = Fault(bench, ARM.status, SPOILED[name])
    record, _ = run(bench)
    assert record.status == TaskStatus.STOPPED
    assert "the robot has sent no status for" in record.message
    assert "Since the last usable status" in record.message
    assert "messages were left out: IIWA_STATUS" in record.message
    assert bench.find_stop(fault.begun, NEAR) < STOPS_WITHIN


@pytest.mark.slow
@pytest.mark.parametrize("name", ["future", "past"])
def test_where_the_robot_s_clock_truly_jumps_the_arm_is_stopped_and_the_next_run_goes_on(
    bench, name
):
    bench.begin()
    jump = {"future": int(FAR), "past": -int(2e6)}[name]
    fault = Fault(bench, ARM.status, SPOILED[name])
    bench.spoil[OBJECT_STATUS] = lambda time, data: [
        data if fault.begun is None else change_pose(data, utime=lambda utime: utime + jump)
    ]
    record, _ = run(bench)
    assert record.status == TaskStatus.STOPPED
    assert f"The robot's clock jumped by {jump / 1e6:.3f} s." in record.message
    assert any("clock jumped" in text for _, text in bench.link.report.events)
    assert bench.find_stop(fault.begun, NEAR) < STOPS_WITHIN
    bench.link.armed = True
    again = bench.task.run(drive=bench.link)
    assert again.status == TaskStatus.FINISHED, again.message
    # and back again, before the other tests
    bench.begin()
    for _ in range(100):
        bench.move()
        bench.link._listen()


@pytest.mark.slow
def test_where_all_poses_are_from_the_future_the_object_is_not_seen_and_not_pushed_for_long(bench):
    bench.begin()
    fault = Fault(bench, OBJECT_STATUS, put_in_future)
    unseen = watch_unseen(bench)
    try:
        record, _ = run(bench)
    finally:
        del bench.link.advance
    assert bench.link.report.left_out[FROM_FUTURE] >= 1
    first = next(time for time in unseen if time > fault.begun)
    assert first - fault.begun < 0.65  # OBJECT_MAX_AGE, and a look every 0.1 s
    assert record.status != TaskStatus.FINISHED


class BrokenPencilError(Exception):
    """What nobody foresaw."""


def fail_in_loop(bench, begun):
    """The task's own bookkeeping fails in the middle of a push; the guard is well."""
    note = bench.task.note

    def failing(record, time):
        if bench.task.read("executor.status").phase == PushPhase.PUSHING and len(bench.rows) > 20:
            begun.append(bench.time)
            raise BrokenPencilError("the pencil broke")
        return note(record, time)

    bench.task.note = failing
    return lambda: delattr(bench.task, "note")


def fail_in_station(bench, begun):
    """Nothing of the station can be moved on any more, the guard included, from the middle of a push on."""
    take_step = bench.link._step

    def failing(simulator):
        if begun or bench.task.read("executor.status").phase == PushPhase.PUSHING:
            if not begun:
                for _ in range(60):
                    take_step(simulator)
            begun.append(bench.time)
            raise SystemExit("Failure at some.cc:1 in Some(): condition 'it' failed.")
        take_step(simulator)

    bench.link._step = failing
    return lambda: delattr(bench.link, "_step")


def test_a_slow_computer_is_named_as_the_likely_cause_of_a_stop():
    network, _ = InProcessLink.make_pair()
    link = hardware_link.HardwareLink(network, find_robot(PushScenario().directives))
    link._said = GuardStatus().stop_for(
        guard_status.Fault(StopKind.FOLLOWING, "joint 1 is astray"), 1.0
    )
    for _ in range(99):
        link.report.note_period(0.005)
    assert link.explain() == ""
    for _ in range(11):
        link.report.note_period(0.084)
    said = link.explain()
    assert said.startswith("The likely cause is a slow computer: 10 % of the commands came more ")
    assert "the latest after 84 ms" in said
    assert "with a smaller --realtime-rate" in said
    # a force is none of the computer's
    link._said = GuardStatus().stop_for(
        guard_status.Fault(StopKind.FORCE, "the force is 31 N"), 1.0
    )
    assert link.explain() == ""


def test_a_robot_that_falls_silent_is_given_up_after_a_second(bench):
    bench.begin()
    dropped = []

    def drop(time, data):
        if dropped or bench.task.read("executor.status").phase == PushPhase.PUSHING:
            dropped.append(time)
        return [] if dropped else [data]

    bench.spoil[ARM.status] = drop
    record, _ = run(bench)
    assert record.status == TaskStatus.STOPPED
    assert "No usable status of the robot came for 1.00 s" in record.message
    # it was waited for so long, and after that no longer than to end the run
    assert 0.95 < dropped[-1] - dropped[0] < 1.2


@pytest.mark.slow
def test_the_link_waits_for_as_long_as_the_arm_goes_back(monkeypatch):
    """The task fails while the arm goes back from a collision, by a way of 0.1 m."""
    monkeypatch.setattr(hardware_link, "STOPPING_TIME", PATIENCE)
    scenario = make_book_scenario()
    scenario.safety.retreat = 0.1
    bench = TwinBench(scenario, IdentifyTask)
    bench.begin()
    torque = partial(change_status, joint_torque_external=lambda torque: [40.0, *torque[1:]])
    fault = Fault(bench, ARM.status, torque, count=1)
    note = bench.task.note

    def fail_while_it_goes_back(record, time):
        if bench.task.read("guard.status").stopped and bench.time > fault.begun + 0.2:
            raise BrokenPencilError("the pencil broke")
        return note(record, time)

    bench.task.note = fail_while_it_goes_back
    record, sent = run(bench)
    assert "BrokenPencilError" in record.message
    begun = next(time for time, text in bench.link.report.events if "guard stopping" in text)
    held = next(time for time, text in bench.link.report.events if "guard holding: " in text)
    print(f"it went back for {held - begun:.2f} s")
    assert held - begun > 0.2 + PATIENCE + 0.5
    posture = ArmPosture(bench.twin.world.setting.control_plant, find_robot(scenario.directives))
    tips = np.array([posture.calc_tip_pose(q).translation() for q in sent])
    steps = np.linalg.norm(np.diff(tips, axis=0), axis=1)
    back = steps[-round((held - begun) / ARM_PERIOD) :].sum()
    assert 0.095 < back < 0.1 + 0.01  # with what it needed for braking


@pytest.mark.parametrize(
    ("fail", "says", "by"),
    [
        (fail_in_loop, "The controller failed: BrokenPencilError: the pencil broke.", "guard"),
        pytest.param(
            fail_in_station,
            "The controller failed: SystemExit: Failure at some.cc:1",
            "without the guard",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_whatever_fails_the_arm_is_braked_and_what_was_done_is_written(
    bench, fail, says, by, tmp_path, capsys
):
    bench.begin()
    begun = []
    restore = fail(bench, begun)
    try:
        record, sent = run(bench)
    finally:
        restore()
    assert record.status == TaskStatus.STOPPED
    assert says in record.message
    assert any(by in text for _, text in bench.link.report.events)
    # the arm was moving, came to rest smoothly, and stays there
    velocity = np.diff(sent, axis=0) / ARM_PERIOD
    assert np.abs(velocity).max() > 0.05
    limit = bench.task.station.scenario.safety.acceleration
    assert np.abs(np.diff(velocity, axis=0)).max() / ARM_PERIOD < 1.001 * limit
    np.testing.assert_allclose(velocity[-1], 0.0, atol=1e-9)
    for _ in range(100):
        bench.move()
    assert bench.find_stop(begun[0], NEAR) < STOPS_WITHIN
    # log, record and report, and an exit code that is not 0
    task, scenario = TASK_KINDS["identify"], bench.task.station.scenario
    summary = robot_command._report(task, scenario, record, bench.link, tmp_path, False, False)
    assert summary["status"] == "stopped"
    assert says in capsys.readouterr().err.replace("\n", " ")
    log = (tmp_path / "robot.log").read_text()
    assert says.rstrip(".") in log
    assert "Traceback" in log
    assert {"object.yaml", "scenario.yaml", "stream.csv"} <= {
        path.name for path in tmp_path.iterdir()
    }


@pytest.mark.slow
def test_commands_that_are_no_commands_are_left_out_by_the_twin(bench):
    bench.begin()
    count = [0]

    def disturb(data):
        count[0] += 1
        if count[0] % 10 != 3:
            return [data]
        message = lcmt_iiwa_command.decode(data)
        message.joint_position = [math.nan, *message.joint_position[1:]]
        return [message.encode(), data[:-2], data + b"more", data]

    bench.disturb = disturb
    record = bench.task.run(drive=bench.link)
    assert record.status == TaskStatus.FINISHED, record.message
    assert sum(bench.twin_link.left_out.values()) > 10
