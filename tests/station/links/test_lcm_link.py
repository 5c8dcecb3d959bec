"""Records and the bytes of LCM: those of Drake's own drivers, both ways."""

import numpy as np
import pytest
from drake import lcmt_schunk_wsg_command, lcmt_schunk_wsg_status
from pydrake.lcm import DrakeLcm
from pydrake.manipulation import (
    IiwaCommandSender,
    IiwaStatusSender,
    PandaCommandSender,
    PandaControlMode,
    PandaStatusSender,
    SchunkWsgCommandSender,
    SchunkWsgStatusSender,
)
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.lcm import LcmPublisherSystem

from gridpush_drake.perception import Camera, Frame
from gridpush_drake.station.links.lcm.lcm_link import LcmLink
from gridpush_drake.station.links.lcm.lcm_messages import (
    IIWA,
    PANDA,
    encode_gripper_command,
    encode_gripper_status,
)
from gridpush_drake.station.links.link import SKIPPED, LinkRole
from gridpush_drake.station.robot.robot import find_robot, make_robot_directives
from gridpush_drake.systems.robot_records import (
    ArmCommand,
    ArmStatus,
    GripperCommand,
    GripperStatus,
    PoseObservation,
)

TIME = 1.25

STATUS = ArmStatus(
    TIME,
    position=[1.0, 2.0],
    velocity=[3.0, 4.0],
    torque_external=[5.0, 6.0],
    position_commanded=[7.0, 8.0],
    torque_commanded=[9.0, 10.0],
    torque_measured=[11.0, 12.0],
)

STATUS_PORTS = {
    "position_measured": STATUS.position,
    "velocity_estimated": STATUS.velocity,
    "torque_external": STATUS.torque_external,
    "position_commanded": STATUS.position_commanded,
    "torque_commanded": STATUS.torque_commanded,
    "torque_measured": STATUS.torque_measured,
}

PANDA_PORTS = {
    "velocity_measured" if name == "velocity_estimated" else name: value
    for name, value in STATUS_PORTS.items()
}

COMMAND = ArmCommand(TIME, [0.5, -0.5])

WIRE = {
    "iiwa status": (
        IiwaStatusSender(2),
        IIWA.status_type,
        STATUS_PORTS,
        IIWA.encode_status(STATUS),
    ),
    "panda status": (
        PandaStatusSender(2),
        PANDA.status_type,
        PANDA_PORTS,
        PANDA.encode_status(STATUS),
    ),
    "iiwa command": (
        IiwaCommandSender(2),
        IIWA.command_type,
        {"position": COMMAND.position},
        IIWA.encode_command(COMMAND),
    ),
    "panda command": (
        PandaCommandSender(2, PandaControlMode.kPosition),
        PANDA.command_type,
        {"position": COMMAND.position},
        PANDA.encode_command(COMMAND),
    ),
}
"""Drake's own senders, what is on their ports, and what is made of the same record here."""


def send_by_drake(sender, kind, ports):
    """The bytes that Drake's own systems send of what is on a sender's ports."""
    lcm, sent = DrakeLcm("memq://"), []
    lcm.Subscribe("CHANNEL", sent.append)
    builder = DiagramBuilder()
    builder.AddSystem(sender)
    publisher = builder.AddSystem(
        LcmPublisherSystem.Make("CHANNEL", kind, lcm, publish_period=1.0, use_cpp_serializer=True)
    )
    builder.Connect(sender.get_output_port(0), publisher.get_input_port())
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    context.SetTime(TIME)
    own = sender.GetMyContextFromRoot(context)
    for port, value in ports.items():
        if isinstance(port, str):
            port = sender.GetInputPort(port).get_index()
        sender.get_input_port(port).FixValue(own, value)
    publisher.ForcedPublish(publisher.GetMyContextFromRoot(context))
    lcm.HandleSubscriptions(0)
    return sent[0]


@pytest.mark.parametrize("name", WIRE)
def test_an_arms_messages_are_those_of_drakes_drivers_byte_by_byte(name):
    sender, kind, ports, data = WIRE[name]
    assert data == send_by_drake(sender, kind, ports)


def test_a_grippers_messages_are_those_of_drakes_driver_byte_by_byte():
    command = GripperCommand(TIME, 0.03125, 12.0)
    ports = {"position": [command.opening], "force_limit": [command.force]}
    assert encode_gripper_command(command) == send_by_drake(
        SchunkWsgCommandSender(), lcmt_schunk_wsg_command, ports
    )
    status = GripperStatus(TIME, 0.03125, -0.125, 8.0)
    ports = {0: [status.opening, status.speed], 1: [status.force]}
    assert encode_gripper_status(status) == send_by_drake(
        SchunkWsgStatusSender(), lcmt_schunk_wsg_status, ports
    )


ROBOT = find_robot(make_robot_directives("iiwa14", grasping=True))
CAMERA = Camera(8, 6, np.eye(3), np.zeros(0))


def open_links(*roles, others=0):
    """Links of roles on one network in memory."""
    lcm = DrakeLcm("memq://")
    return [LcmLink(lcm, ROBOT, role, camera=CAMERA, others=others) for role in roles]


def test_records_keep_all_they_say_on_their_way_over_lcm():
    control, robot, tracker = open_links(
        LinkRole.CONTROL, LinkRole.ROBOT, LinkRole.TRACKER, others=2
    )
    sent = [
        STATUS,
        GripperStatus(1.5, 0.03125, -0.125, 12.0),
        PoseObservation(1.75, [0.5, -0.25, 3.0]),
        PoseObservation(1.8, [0.6, np.nan, -1.0], number=2),
    ]
    for record in sent:
        robot.send(record)
    received = control.receive(0.0)
    assert [type(record) for record in received] == [type(record) for record in sent]
    for before, after in zip(sent, received, strict=True):
        for field, value in vars(before).items():
            np.testing.assert_array_equal(getattr(after, field), value)
    assert [type(record) for record in tracker.receive(0.0)] == [ArmStatus, GripperStatus]
    commands = [ArmCommand(2.0, STATUS.position), GripperCommand(2.0, 0.0625, 5.0)]
    for record in commands:
        control.send(record)
    arm, gripper = robot.receive(0.0)
    assert (arm.time, tuple(arm.position)) == (2.0, STATUS.position)
    assert gripper == commands[1]
    assert control.receive(0.0) == []


def test_of_several_pictures_the_newest_is_unpacked():
    camera, tracker = open_links(LinkRole.CAMERA, LinkRole.TRACKER)
    for t in (1.0, 1.1, 1.2):
        color = np.full((CAMERA.height, CAMERA.width, 3), round(100 * t), np.uint8)
        camera.send(Frame(color, None, t))
    *skipped, frame = tracker.receive(0.0)
    assert skipped == [SKIPPED] * 2
    assert frame.t == 1.2
    assert abs(int(frame.color[0, 0, 0]) - 120) <= 2
    assert tracker.receive(0.0) == []
