"""Messages and records of every kind, spoiled in every way, at the side that receives them."""

import math
import struct
from collections import Counter
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from drake import (
    lcmt_iiwa_command,
    lcmt_iiwa_status,
    lcmt_panda_command,
    lcmt_panda_status,
    lcmt_planar_manipuland_status,
    lcmt_schunk_wsg_command,
    lcmt_schunk_wsg_status,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.lcm import DrakeLcm
from pydrake.manipulation import PandaControlMode

from gridpush_drake.perception import Camera, Frame
from gridpush_drake.station.hardware.twin_link import TwinLink
from gridpush_drake.station.links.channel import (
    MAX_REASONS,
    NEW_CLOCK_MESSAGES,
    OTHER_REASONS,
    ArrivalClock,
    Channel,
    count_reason,
)
from gridpush_drake.station.links.lcm.lcm_link import LcmLink
from gridpush_drake.station.links.lcm.lcm_messages import GRIPPER_COMMAND
from gridpush_drake.station.links.link import LinkRole, Unusable
from gridpush_drake.station.links.record_forms import FORMS, find_form_fault, find_frame_fault
from gridpush_drake.station.robot.robot import find_robot, make_robot_directives
from gridpush_drake.systems.robot_records import (
    ArmCommand,
    ArmStatus,
    GripperCommand,
    GripperStatus,
    PoseObservation,
)

JOINTS = 7
CLOCK_JUMP = 0.1
POSITION = PandaControlMode.kPosition

IIWA = find_robot(make_robot_directives("iiwa14", grasping=True))
PANDA = find_robot(make_robot_directives("panda", grasping=False))

READERS = {
    lcmt_iiwa_status: (ArmStatus, IIWA, LinkRole.CONTROL),
    lcmt_panda_status: (ArmStatus, PANDA, LinkRole.CONTROL),
    lcmt_schunk_wsg_status: (GripperStatus, IIWA, LinkRole.CONTROL),
    lcmt_planar_manipuland_status: (PoseObservation, IIWA, LinkRole.CONTROL),
    lcmt_iiwa_command: (ArmCommand, IIWA, LinkRole.ROBOT),
    lcmt_panda_command: (ArmCommand, PANDA, LinkRole.ROBOT),
    lcmt_schunk_wsg_command: (GripperCommand, IIWA, LinkRole.ROBOT),
}
"""What is made of each kind of message, and who reads it."""

EMPTY = {
    lcmt_iiwa_command: {"joint_torque"},
    lcmt_panda_command: {"joint_velocity", "joint_torque"},
}
"""Fields in which a sender need not say anything."""


def list_numbers(kind):
    """Names of the fields of a kind of message that hold numbers."""
    message = kind()
    return [n for n in message.__slots__ if isinstance(getattr(message, n), float | list)]


def make_message(kind, utime=1_000_000, joints=JOINTS):
    """A message of a kind with small numbers in all its fields."""
    message = kind()
    message.utime = utime
    for name in list_numbers(kind):
        value = getattr(message, name)
        if isinstance(value, list) and name not in EMPTY.get(kind, ()):
            setattr(message, name, [0.25] * (len(value) or joints))
        elif isinstance(value, float):
            setattr(message, name, 0.25)
    for name, size in (
        ("num_joints", joints),
        ("num_joint_position", joints),
        ("control_mode_expected", int(POSITION)),
        ("control_mode", int(POSITION)),
    ):
        if hasattr(message, name):
            setattr(message, name, size)
    return message


class Receiver:
    """A network, its link, and after it the channel of one kind of records."""

    def __init__(self, kind):
        self.left_out = Counter()
        self.time = 0.0
        self._network = DrakeLcm("memq://")
        record, robot, role = READERS[kind]
        self._link = LcmLink(self._network, robot, role)
        self.name = self._link.get_name(record)
        self.channel = Channel(
            self.name,
            joints=JOINTS,
            now=lambda: self.time,
            clock_jump=CLOCK_JUMP,
            leave_out=partial(count_reason, self.left_out),
        )

    def take(self, data):
        """Gives the network a message; returns whether a record of it can be used."""
        self._network.Publish(self.name, data)
        (message,) = self._link.receive(0.0)
        if isinstance(message, Unusable):
            self.channel.leave_out(message.why)
            return False
        if not self.channel.take(message):
            return False
        for field, form in FORMS[type(message)].items():
            values = np.array(getattr(message, field), dtype=float).ravel()
            assert len(values) == (form.count or JOINTS), field
            assert form.unknown or np.isfinite(values).all(), field
        return True


KINDS = sorted(READERS, key=lambda kind: kind.__name__)


@pytest.fixture(scope="module")
def receivers():
    return {kind: Receiver(kind) for kind in KINDS}


def restart(receiver):
    """The receiver's channel as if nothing had come yet."""
    channel = receiver.channel
    channel.time, channel.unusable, channel._stray = -1.0, 0, None
    channel.clock.restart()
    receiver.left_out.clear()


@pytest.mark.parametrize("kind", KINDS)
def test_a_whole_message_is_taken_and_read(receivers, kind):
    receiver = receivers[kind]
    restart(receiver)
    assert receiver.take(make_message(kind).encode())
    assert receiver.left_out == {}


WRONG = st.sampled_from([math.nan, math.inf, -math.inf, 1e300, -1e300, 1e7])


@settings(max_examples=300, deadline=None)
@given(kind=st.sampled_from(KINDS), data=st.data())
def test_a_number_in_any_field_that_is_not_one_is_left_out_and_named(receivers, kind, data):
    receiver = receivers[kind]
    restart(receiver)
    name = data.draw(st.sampled_from(list_numbers(kind)))
    wrong, message = data.draw(WRONG), make_message(kind)
    value = getattr(message, name)
    if isinstance(value, list):
        if not value:  # an optional one
            value = [0.0] * JOINTS
            count = "num_torques" if kind is lcmt_iiwa_command else f"num_{name}"
            setattr(message, count, JOINTS)
        value[data.draw(st.integers(0, len(value) - 1))] = wrong
        setattr(message, name, value)
    else:
        setattr(message, name, wrong)
    taken = receiver.take(message.encode())
    assert taken == (math.isnan(wrong) and kind is lcmt_planar_manipuland_status)
    if not taken:
        assert [name in why and receiver.name in why for why in receiver.left_out] == [True]


RECORDS = {
    ArmStatus: lambda q: ArmStatus(1.0, q, q, q, q, torque_commanded=q, torque_measured=q),
    GripperStatus: lambda q: GripperStatus(1.0, 0.1, 0.1, 0.1),
    PoseObservation: lambda q: PoseObservation(1.0, [0.1, 0.1, 0.1]),
    ArmCommand: lambda q: ArmCommand(1.0, q),
    GripperCommand: lambda q: GripperCommand(1.0, 0.1, 0.1),
}
"""Records that can be used, made of the numbers of joints."""


@pytest.mark.parametrize("kind", FORMS)
@pytest.mark.parametrize("wrong", [np.nan, -np.inf, 1e9, "wide", [], [1.0] * 6, None])
def test_whatever_a_link_puts_into_a_record_is_found_out(kind, wrong):
    """A link of one's own may put anything there."""
    record = RECORDS[kind](np.full(JOINTS, 0.1))
    assert find_form_fault(record, "it", JOINTS) == ""
    for field, form in FORMS[kind].items():
        value = wrong
        if isinstance(wrong, float) and form.count != 1:
            value = [*getattr(record, field)[:-1], wrong]
        may_be = (wrong is None and form.optional) or (wrong is np.nan and form.unknown)
        fault = find_form_fault(replace(record, **{field: value}), "it", JOINTS)
        says = (f"it: {field} ", "it speaks of ")  # the latter, of another number of joints
        assert fault == "" if may_be else fault.startswith(says), (field, fault)
    for time in (np.nan, -1.0, np.inf, 1e15, "now", None):
        fault = find_form_fault(replace(record, time=time), "it", JOINTS)
        assert fault.startswith("it: time ")


def test_a_record_keeps_its_numbers_whatever_its_sender_writes_over_them():
    buffer, more = np.zeros(JOINTS), [0.0] * JOINTS
    status = ArmStatus(1.0, buffer, more, buffer)
    buffer[2] = more[2] = math.nan
    assert find_form_fault(status, "it", JOINTS) == ""
    with pytest.raises(ValueError, match="read-only"):
        status.position[0] = 1.0


def test_a_record_that_cannot_even_be_looked_at_is_left_out():
    channel, _, left_out = make_channel()
    assert not channel.take(None)
    assert left_out == {"CHANNEL could not be looked at (AttributeError)": 1}


def test_a_picture_of_another_size_or_kind_is_found_out():
    camera = Camera(4, 3, np.eye(3), np.zeros(0))
    good = Frame(np.zeros((3, 4, 3), np.uint8), np.zeros((3, 4), np.float32), 1.0)
    assert find_frame_fault(good, "it", camera) == ""
    assert find_frame_fault(good._replace(depth=None), "it", camera) == ""
    for field, wrong in (
        ("color", None),
        ("color", good.color[..., :2]),
        ("color", good.color.astype(float)),
        ("depth", good.depth.T),
        ("depth", good.depth.astype(np.uint16)),
        ("t", np.nan),
    ):
        fault = find_frame_fault(good._replace(**{field: wrong}), "it", camera)
        assert fault.startswith(f"it: {field} "), fault


@settings(max_examples=500, deadline=None)
@given(kind=st.sampled_from(KINDS), data=st.data())
def test_spoiled_bytes_end_nothing(receivers, kind, data):
    """Bytes are changed, cut off, put in and repeated; whatever is let through is a record with usable numbers."""
    receiver = receivers[kind]
    restart(receiver)
    whole = bytearray(make_message(kind).encode())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(whole)))
        what = data.draw(st.sampled_from(["change", "cut", "put in", "repeat", "number"]))
        if what == "cut":
            del whole[at:]
        elif what == "put in":
            whole[at:at] = data.draw(st.binary(min_size=1, max_size=9))
        elif what == "repeat":
            whole += whole[at:]
        elif what == "number" and len(whole) >= 16:
            at = data.draw(st.integers(8, len(whole) - 8))
            whole[at : at + 8] = struct.pack(">d", data.draw(st.floats(allow_nan=True)))
        elif at < len(whole):
            whole[at] = data.draw(st.integers(0, 255))
    taken = receiver.take(bytes(whole))
    assert taken == (not receiver.left_out)


@settings(max_examples=100, deadline=None)
@given(joints=st.integers(0, 20).filter(lambda n: n != JOINTS), kind=st.sampled_from(KINDS))
def test_another_number_of_joints_is_left_out(receivers, joints, kind):
    receiver = receivers[kind]
    restart(receiver)
    per_joint = READERS[kind][0] in (ArmStatus, ArmCommand)
    assert receiver.take(make_message(kind, joints=joints).encode()) != per_joint


@settings(max_examples=60, deadline=None)
@given(mode=st.integers(-128, 127), speeds=st.booleans(), torques=st.booleans())
def test_a_panda_s_command_of_another_mode_ends_nothing(receivers, mode, speeds, torques):
    receiver, message = receivers[lcmt_panda_command], make_message(lcmt_panda_command)
    restart(receiver)
    message.control_mode_expected = mode
    message.num_joint_velocity, message.joint_velocity = JOINTS * speeds, [0.1] * JOINTS * speeds
    message.num_joint_torque, message.joint_torque = JOINTS * torques, [0.1] * JOINTS * torques
    assert receiver.take(message.encode()) == (mode == int(POSITION))


def make_channel(reference=None):
    """A channel of the object's poses, the list of its reader's times, and what it left out."""
    now, left_out = [0.0], Counter()
    channel = Channel(
        "CHANNEL",
        joints=JOINTS,
        now=lambda: now[0],
        clock_jump=CLOCK_JUMP,
        leave_out=partial(count_reason, left_out),
        reference=reference,
    )
    return channel, now, left_out


def tell(channel, now, sent, arrives):
    """A pose sent at a time, s, by its sender's clock arrives at another one by the reader's."""
    now[0] = arrives
    return channel.take(PoseObservation(sent, [0.25, 0.25, 0.25]))


def test_one_message_from_the_future_changes_nothing_for_those_after_it():
    channel, now, left_out = make_channel()
    for k in range(50):
        assert tell(channel, now, 7.0 + 0.005 * k, 0.005 * k)
    assert not tell(channel, now, 4000.0, 0.25)
    assert not tell(channel, now, 7.25 + 1.1 * CLOCK_JUMP, 0.2501)
    assert tell(channel, now, 7.255, 0.255)
    assert left_out == {"CHANNEL is from the future, by its sender's own clock": 2}
    assert (channel.clock_changes, channel.unusable) == (0, 0)


def test_messages_that_were_kept_waiting_are_taken_and_those_after_them_too():
    """A busy reader has many messages at once, and the next ones in time."""
    channel, now, left_out = make_channel()
    for k in range(20):
        assert tell(channel, now, 0.005 * k, 0.005 * k)
    for k in range(20, 24):
        assert tell(channel, now, 0.005 * k, 30.0)
    assert tell(channel, now, 30.005, 30.005)
    assert left_out == {}


def test_a_clock_that_drifts_is_followed():
    channel, now, left_out = make_channel()
    for k in range(20_000):
        assert tell(channel, now, 0.005 * k * (1 + 2e-3), 0.005 * k)
    assert left_out == {}
    assert channel.clock_changes == 0


@pytest.mark.parametrize("jump", [3600.0, -3600.0, 0.5, -0.5])
def test_a_clock_that_truly_jumps_is_told_by_several_messages_in_a_row(jump):
    channel, now, left_out = make_channel()
    for k in range(20):
        assert tell(channel, now, 5000 + 0.005 * k, 0.005 * k)
    taken = [tell(channel, now, 5000 + 0.005 * k + jump, 0.005 * k) for k in range(20, 50)]
    assert taken == [False] * (NEW_CLOCK_MESSAGES - 1) + [True] * (31 - NEW_CLOCK_MESSAGES)
    assert channel.clock_changes == 1
    assert channel.jump == pytest.approx(jump, abs=1e-6)
    assert sum(left_out.values()) == NEW_CLOCK_MESSAGES - 1


def test_neither_a_clock_that_stands_still_nor_old_messages_among_new_ones_are_a_new_clock():
    channel, now, left_out = make_channel()
    for k in range(20):
        assert tell(channel, now, 100 + 0.005 * k, 0.005 * k)
    for k in range(20, 60):
        assert not tell(channel, now, 100 + 0.005 * 19, 0.005 * k)
    for k in range(60, 100):
        assert tell(channel, now, 100 + 0.005 * k, 0.005 * k)
        assert not tell(channel, now, 50 + 0.005 * k, 0.005 * k)
    assert channel.clock_changes == 0
    assert left_out == {"CHANNEL was not newer than the one before": 80}


def test_a_first_message_with_a_wrong_time_is_found_out():
    channel, now, _ = make_channel()
    assert tell(channel, now, 9e6, 0.0)
    taken = [tell(channel, now, 1.0 + 0.005 * k, 0.005 * k) for k in range(1, 20)]
    assert taken.index(True) == NEW_CLOCK_MESSAGES - 1
    assert all(taken[taken.index(True) :])
    assert channel.clock_changes == 1


def test_the_object_s_time_is_by_the_robot_s_clock():
    """Even a tracker all of whose messages are from the future is not believed."""
    clock = ArrivalClock()
    channel, now, left_out = make_channel(clock)
    for k in range(60):
        clock.add(50.0 + 0.005 * k, 0.005 * k)
        assert tell(channel, now, 50.0 + 0.005 * k - 0.2, 0.005 * k)
    for k in range(60, 120):
        clock.add(50.0 + 0.005 * k, 0.005 * k)
        assert not tell(channel, now, 50.0 + 0.005 * k + 0.2, 0.005 * k)
    assert left_out == {"CHANNEL is from the future, by the robot's clock": 60}
    assert tell(channel, now, 50.6 - 0.2, 0.6)


def test_reasons_are_counted_and_their_number_is_bounded():
    counts = Counter()
    assert count_reason(counts, "one")
    assert not count_reason(counts, "one")
    for k in range(3 * MAX_REASONS):
        count_reason(counts, f"reason {k}")
    assert len(counts) == MAX_REASONS + 1
    assert counts["one"] == 2
    assert counts[OTHER_REASONS] == 2 * MAX_REASONS + 1


def test_the_account_of_what_came_since_the_last_usable_message():
    channel, now, _ = make_channel()
    assert channel.describe_unusable() == ""
    nothing = PoseObservation(0.0, [])
    channel.take(nothing)
    says = "left out: CHANNEL: pose is of another size; expected 3"
    assert channel.describe_unusable() == f"1 message was {says}"
    channel.take(nothing)
    assert channel.describe_unusable() == f"2 messages were {says}"
    assert tell(channel, now, 1.0, 0.0)
    assert channel.describe_unusable() == ""


class Heard(list):
    """Stands for a twin, and remembers its commands."""

    def TakeCommand(self, context, command):
        self.append(command)


def test_a_twin_hears_whole_commands_only():
    network = DrakeLcm("memq://")
    link, heard = TwinLink(LcmLink(network, IIWA, LinkRole.ROBOT), IIWA), Heard()

    def say(name, message):
        network.Publish(name, message if isinstance(message, bytes) else message.encode())
        link.exchange(heard, None)

    good, grip = make_message(lcmt_iiwa_command), make_message(lcmt_schunk_wsg_command)
    say("IIWA_COMMAND", good)
    say(GRIPPER_COMMAND, grip)
    command, opening = heard
    assert (command.time, list(command.position)) == (1.0, [0.25] * JOINTS)
    assert opening == GripperCommand(1.0, 0.25e-3, 0.25)
    bad = make_message(lcmt_iiwa_command)
    bad.joint_position = [0.0] * 6 + [math.nan]
    say("IIWA_COMMAND", bad)
    say("IIWA_COMMAND", good.encode() + b"more")
    say("IIWA_COMMAND", make_message(lcmt_iiwa_command, joints=6))
    grip.target_position_mm = math.inf
    say(GRIPPER_COMMAND, grip)
    assert len(heard) == 2
    assert sum(link.left_out.values()) == 4
    assert "1 left out: IIWA_COMMAND: joint_position is not finite" in link.describe_left_out()
