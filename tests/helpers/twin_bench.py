"""A twin and what moves it, in one process and in lockstep; a test may spoil what passes between them."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.lcm import DrakeLcm
from pydrake.systems.analysis import Simulator

from gridpush_drake.objects.object_file import dump_object
from gridpush_drake.perception.tracking.tracking import TrackedPose
from gridpush_drake.station.hardware.hardware_link import HardwareLink
from gridpush_drake.station.hardware.hardware_station import MakeHardwareStation
from gridpush_drake.station.hardware.picture_tracker import PictureTracker
from gridpush_drake.station.hardware.twin import MakeTwin
from gridpush_drake.station.hardware.twin_camera import TwinCamera
from gridpush_drake.station.hardware.twin_link import TwinLink
from gridpush_drake.station.links.lcm.lcm_link import LcmLink
from gridpush_drake.station.links.lcm.lcm_messages import find_arm_messages, name_object_channel
from gridpush_drake.station.links.link import ARM_PERIOD, LinkRole
from gridpush_drake.station.robot.robot import find_robot
from gridpush_drake.station.scene.camera import make_camera
from gridpush_drake.station.schema.scenario import PushScenario

COARSE_BOOK = str(Path(__file__).with_name("coarse_book.yaml"))
"""An object that is simulated fast."""

COARSE_HAMMER = str(Path(__file__).with_name("coarse_hammer.yaml"))
"""The shipped hammer with a third of its cells, for speed, too."""

Spoiler = Callable[[float, bytes], list[bytes]]
"""Of the twin's time, s, and a message: what comes instead."""


def make_book_scenario() -> PushScenario:
    """A push of a book that the finger is near to; only exact loads, so that it is simulated fast."""
    scenario = PushScenario(object=COARSE_BOOK, base="planar", object_pose=[0.55, 0.0, 0.0])
    scenario.pokes.count, scenario.pokes.test_count, scenario.pokes.speed = 1, 0, 0.08
    scenario.pokes.distance = [0.05, 0.05]
    return scenario


class TwinBench:
    """The twin with its link, the link to it and a task; what the arm does is written down at every status.

    Attributes:
        spoil: by the channel, what becomes of the twin's messages.
        disturb: what becomes of the commands.
        paused: for how many periods yet it stands still, as a twin whose computer is busy.
        rows: (time, positions, velocities) of the twin's arm, s, rad and rad/s.
    """

    def __init__(self, scenario: PushScenario, task: type) -> None:
        self.lcm, self._network = DrakeLcm("memq://"), DrakeLcm("memq://")
        robot = find_robot(scenario.directives, pusher=scenario.pusher)
        self.messages = find_arm_messages(robot)
        others = len(scenario.others)
        edge = LcmLink(self._network, robot, LinkRole.ROBOT)
        self.twin_link = TwinLink(edge, robot)
        self.twin = MakeTwin(scenario, edge.send)
        self.simulator = Simulator(self.twin)
        self.spoil: dict[str, Spoiler] = {}
        self.disturb: Callable[[bytes], list[bytes]] | None = None
        self.rows: list[tuple[float, np.ndarray, np.ndarray]] = []
        objects = [name_object_channel(number) for number in range(others + 1)]
        for channel in (self.messages.status, *objects):
            self._network.Subscribe(channel, partial(self._pass_out, channel))
        self.lcm.Subscribe(self.messages.command, self._pass_in)
        self._last: Any = None
        self._count = self._moves = self.paused = 0
        self._reset()
        called = scenario.names.name_others(others)
        self.link = HardwareLink(
            LcmLink(self.lcm, robot, LinkRole.CONTROL, others=others),
            robot,
            others=called,
            clock_jump=scenario.safety.clock_jump,
            robot=self.move,
            clock=self.read_clock,
        )
        self.task = task(scenario, make_station=MakeHardwareStation)

    @property
    def time(self) -> float:
        return float(self.simulator.get_context().get_time())

    def read_clock(self) -> float:
        """The observer's clock, s: it goes on while the twin pauses."""
        return self._moves * ARM_PERIOD

    def begin(self) -> None:
        """The twin as at its beginning, but for its clock, and all as it should be."""
        self.spoil.clear()
        self.disturb = None
        self.rows.clear()
        self.link.report.events.clear()
        self.link.report.left_out.clear()
        self.link.report.traces.clear()
        self.link.report.silences = self.link.report.pauses = (
            0  # of which only the first ones are written down
        )
        self._reset()
        while any(each.record is None for each in self.link._objects) or len(self.rows) < 10:
            self.move()
            self.link._listen()
        self.link.armed = True

    def move(self) -> None:
        """Moves the twin on by a period; its messages go out, and commands come in."""
        self._moves += 1
        if self.paused > 0:
            self.paused -= 1
            return
        self._count += 1
        self.twin_link.exchange(self.twin, self.simulator.get_mutable_context())
        self.simulator.AdvanceTo((self._count + 0.5) * ARM_PERIOD)
        self._network.HandleSubscriptions(0)
        plant, arm = self.twin.world.plant, self.twin.world.robot_in_plant.arm
        context = plant.GetMyContextFromRoot(self.simulator.get_context())
        self.rows.append(
            (self.time, plant.GetPositions(context, arm), plant.GetVelocities(context, arm))
        )

    def find_stop(self, begin: float, near: float) -> float:
        """How long after `begin`, s, all joints were where they are now, as near as `near`, rad, for good."""
        held = self.rows[-1][1]
        away = [time for time, q, _ in self.rows if time > begin and np.abs(q - held).max() > near]
        return max(away, default=begin) - begin

    def calc_force(self) -> float:
        """On the finger's tip from the object, N, as it truly is."""
        plant, tip = self.twin.world.plant, self.twin.world.setting.robot.finger.tip_frame
        contacts = plant.get_contact_results_output_port().Eval(
            plant.GetMyContextFromRoot(self.simulator.get_context())
        )
        infos = map(contacts.point_pair_contact_info, range(contacts.num_point_pair_contacts()))
        body = plant.GetBodyByName(tip).index()
        forces = [
            info.contact_force()
            for info in infos
            if body in (info.bodyA_index(), info.bodyB_index())
        ]
        return float(np.linalg.norm(np.sum(forces, axis=0))) if forces else 0.0

    def _reset(self) -> None:
        context = self.twin.CreateDefaultContext()
        context.SetTime((self._count + 0.5) * ARM_PERIOD)
        self.simulator.reset_context(context)
        self.twin.SetStart(context)
        if self._last is not None:  # with which the driver would begin
            self._last.joint_position = self.twin.world.setting.q_start.tolist()
            self._network.Publish(self.messages.command, self._last.encode())
            self.twin_link.exchange(self.twin, context)
        self.simulator.Initialize()

    def _pass_in(self, data: bytes) -> None:
        self._last = self.messages.command_type.decode(data)
        for message in [data] if self.disturb is None else self.disturb(data):
            self._network.Publish(self.messages.command, message)

    def _pass_out(self, channel: str, data: bytes) -> None:
        spoil = self.spoil.get(channel)
        for message in [data] if spoil is None else spoil(self.time, data):
            self.lcm.Publish(channel, message)


class CameraBench(TwinBench):
    """The twin with a color and depth camera, and a tracker that finds the object which the task is given.

    Attributes:
        tracker: sees every picture.
        seen: (time, where the object truly is (3,), what the tracker said) of each.
    """

    def __init__(self, scenario: PushScenario, task: type, folder: Path) -> None:
        self.seen: list[tuple[float, np.ndarray, TrackedPose]] = []
        self._camera, self.tracker = TwinCamera(scenario), None
        super().__init__(scenario, lambda scenario, make_station: None)
        robot, others = (
            find_robot(scenario.directives, pusher=scenario.pusher),
            len(scenario.others),
        )
        self._eye = LcmLink(self.lcm, robot, LinkRole.CAMERA)
        camera = make_camera(scenario.camera)
        sight = LcmLink(self.lcm, robot, LinkRole.TRACKER, camera=camera, others=others)
        self.tracker = PictureTracker(scenario, sight, clock=self.read_clock)
        if scenario.others:  # whose outlines the task is told
            self.task = task(scenario, make_station=MakeHardwareStation)
            return
        while self.tracker.obj is None:
            self.move()
        obj = self.tracker.obj
        (folder / "object.yaml").write_text(dump_object(obj.name, obj.grid, obj.prior, obj.height))
        known = scenario.model_copy(deep=True)
        known.object = str(folder / "object.yaml")
        self.task = task(known, make_station=MakeHardwareStation)

    def move(self) -> None:
        before, rate = self.time, self.twin.world.setting.scenario.camera.rate
        super().move()
        if self.tracker is None or int(self.time * rate) == int(before * rate):
            return
        context = self.simulator.get_context()
        self._eye.send(self._camera.take(self.time, self.twin.GetPositions(context)))
        tracked = self.tracker.step()
        if tracked is not None:
            self.seen.append((self.time, self.find_true_pose(), tracked))

    def find_true_pose(self) -> np.ndarray:
        world, context = self.twin.world, self.simulator.get_context()
        own = world.plant.GetMyContextFromRoot(context)
        X_WB = world.plant.EvalBodyPoseInWorld(own, world.object_in_plant.body)
        return np.array([*X_WB.translation()[:2], X_WB.rotation().ToRollPitchYaw().yaw_angle()])
