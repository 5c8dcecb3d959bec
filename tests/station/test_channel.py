"""Messages of every kind, spoiled in every way, at the side that receives them."""

import math
import struct
from collections import Counter
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
from pydrake.manipulation import (
    IiwaCommandReceiver,
    IiwaStatusReceiver,
    PandaCommandReceiver,
    PandaControlMode,
    PandaStatusReceiver,
    SchunkWsgCommandReceiver,
    SchunkWsgStatusReceiver,
)
from pydrake.systems.framework import DiagramBuilder, PortDataType
from pydrake.systems.lcm import LcmSubscriberSystem

from gridpush_drake.station.hardware.twin_link import TwinLink
from gridpush_drake.station.links.channel import (
    MAX_REASONS,
    NEW_CLOCK_MESSAGES,
    OTHER_REASONS,
    ArrivalClock,
    Channel,
    count_reason,
)
from gridpush_drake.station.links.lcm.message_forms import FORMS, find_form_fault
from gridpush_drake.station.links.lcm.robot_messages import GRIPPER_COMMAND
from gridpush_drake.station.robot import find_robot, make_robot_directives
from gridpush_drake.systems.planar_manipuland_status import PlanarManipulandStatusReceiver

JOINTS = 7
CLOCK_JUMP = 0.1
PERIOD = 0.005
POSITION = PandaControlMode.kPosition

RECEIVERS = {
    lcmt_iiwa_status: lambda: IiwaStatusReceiver(JOINTS),
    lcmt_panda_status: lambda: PandaStatusReceiver(JOINTS),
    lcmt_schunk_wsg_status: SchunkWsgStatusReceiver,
    lcmt_planar_manipuland_status: lambda: PlanarManipulandStatusReceiver(PERIOD, 1.0),
    lcmt_iiwa_command: lambda: IiwaCommandReceiver(JOINTS),
    lcmt_panda_command: lambda: PandaCommandReceiver(JOINTS, POSITION),
    lcmt_schunk_wsg_command: lambda: SchunkWsgCommandReceiver(0.1),
}
"""Drake's own systems that read each kind of message, and ours for the object."""


def make_message(kind, utime=1_000_000, joints=JOINTS):
    """A message of a kind with small numbers in all its fields."""
    message = kind()
    message.utime = utime
    for name, numbers in FORMS[kind].items():
        value = getattr(message, name)
        size = joints if numbers.per_joint else len(value) if isinstance(value, list) else None
        if numbers.optional:
            size = 0
        setattr(message, name, 0.25 if size is None else [0.25] * size)
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
    """A channel, and after it on a bus the system that reads its messages, as in station and twin."""

    def __init__(self, kind):
        self.left_out = Counter()
        self.channel = Channel(
            "CHANNEL",
            kind,
            now=lambda: self.time,
            clock_jump=CLOCK_JUMP,
            find_fault=partial(find_form_fault, channel="CHANNEL", joints=JOINTS),
            leave_out=partial(count_reason, self.left_out),
        )
        self.time = 0.0
        self.bus = DrakeLcm("memq://")
        builder = DiagramBuilder()
        cpp = kind is not lcmt_planar_manipuland_status
        self.subscriber = builder.AddSystem(
            LcmSubscriberSystem.Make("CHANNEL", kind, self.bus, use_cpp_serializer=cpp)
        )
        self.system = builder.AddSystem(RECEIVERS[kind]())
        builder.Connect(self.subscriber.get_output_port(), self.system.get_input_port(0))
        self.diagram = builder.Build()
        self.context = self.diagram.CreateDefaultContext()
        own = self.system.GetMyMutableContextFromRoot(self.context)
        for i in range(1, self.system.num_input_ports()):
            port = self.system.get_input_port(i)
            port.FixValue(own, np.zeros(port.size()))

    def take(self, data):
        """Gives the channel a message, and the system what the channel lets through; returns whether it did."""
        if not self.channel.take(data):
            return False
        self.bus.Publish("CHANNEL", self.channel.data)
        self.bus.HandleSubscriptions(0)
        self.diagram.ExecuteInitializationEvents(self.context)
        own = self.system.GetMyContextFromRoot(self.context)
        for i in range(self.system.num_output_ports()):
            port = self.system.get_output_port(i)
            value = port.Eval(own)
            if port.get_data_type() == PortDataType.kVectorValued and (
                self.channel._kind is not lcmt_planar_manipuland_status
            ):
                assert np.isfinite(value).all(), port.get_name()
        return True


KINDS = sorted(FORMS, key=lambda kind: kind.__name__)


@pytest.fixture(scope="module")
def receivers():
    return {kind: Receiver(kind) for kind in KINDS}


def restart(receiver):
    """The receiver's channel as if nothing had come yet."""
    channel = receiver.channel
    channel.utime, channel.unusable, channel._stray = -1, 0, None
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
    name = data.draw(st.sampled_from(sorted(FORMS[kind])))
    numbers, wrong, message = FORMS[kind][name], data.draw(WRONG), make_message(kind)
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
    assert taken == (math.isnan(wrong) and numbers.unknown)
    if not taken:
        assert [name in why and "CHANNEL" in why for why in receiver.left_out] == [True]


@settings(max_examples=500, deadline=None)
@given(kind=st.sampled_from(KINDS), data=st.data())
def test_spoiled_bytes_end_nothing(receivers, kind, data):
    """Bytes are changed, cut off, put in and repeated; whatever is let through can be read by Drake's systems."""
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
    per_joint = any(numbers.per_joint for numbers in FORMS[kind].values())
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
        lcmt_planar_manipuland_status,
        now=lambda: now[0],
        clock_jump=CLOCK_JUMP,
        find_fault=partial(find_form_fault, channel="CHANNEL"),
        leave_out=partial(count_reason, left_out),
        reference=reference,
    )
    return channel, now, left_out


def tell(channel, now, sent, arrives):
    """A message sent at a time, s, by its sender's clock arrives at another one by the reader's."""
    now[0] = arrives
    return channel.take(make_message(channel._kind, round(1e6 * sent)).encode())


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
    channel.take(b"nothing")
    says = "left out: CHANNEL is not lcmt_planar_manipuland_status, or not whole"
    assert channel.describe_unusable() == f"1 message was {says}"
    channel.take(b"nothing")
    assert channel.describe_unusable() == f"2 messages were {says}"
    assert tell(channel, now, 1.0, 0.0)
    assert channel.describe_unusable() == ""


def test_a_twin_hears_whole_commands_only():
    network = DrakeLcm("memq://")
    robot = find_robot(make_robot_directives("iiwa14", grasping=True))
    link, heard = TwinLink(network, robot), []
    for name in ("IIWA_COMMAND", GRIPPER_COMMAND):
        link.bus.Subscribe(name, partial(lambda name, data: heard.append((name, data)), name))

    def say(name, message):
        network.Publish(name, message if isinstance(message, bytes) else message.encode())
        link.exchange()

    good, grip = make_message(lcmt_iiwa_command), make_message(lcmt_schunk_wsg_command)
    say("IIWA_COMMAND", good)
    say(GRIPPER_COMMAND, grip)
    assert heard == [("IIWA_COMMAND", good.encode()), (GRIPPER_COMMAND, grip.encode())]
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
    said = []
    network.Subscribe("IIWA_STATUS", said.append)
    link.bus.Publish("IIWA_STATUS", make_message(lcmt_iiwa_status).encode())
    link.exchange()
    network.HandleSubscriptions(0)
    assert said == [make_message(lcmt_iiwa_status).encode()]


def test_every_field_of_every_kind_of_message_has_a_form():
    """All numbers that are not integers of the message's own bookkeeping."""
    for kind, form in FORMS.items():
        numbers = {
            name
            for name, what in zip(kind.__slots__, kind.__typenames__, strict=True)
            if what in ("double", "float")
        }
        assert set(form) == numbers, kind.__name__
