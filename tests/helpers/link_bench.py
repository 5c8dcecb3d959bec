"""A twin and what moves it at the two ends of an `InProcessLink`; a test may spoil what passes along it."""

from collections.abc import Callable

import numpy as np
from pydrake.systems.analysis import Simulator

from gridpush_drake.station.hardware.hardware_link import HardwareLink
from gridpush_drake.station.hardware.hardware_station import MakeHardwareStation
from gridpush_drake.station.hardware.twin import MakeTwin
from gridpush_drake.station.hardware.twin_link import TwinLink
from gridpush_drake.station.links.in_process import InProcessLink
from gridpush_drake.station.links.link import ARM_PERIOD, LinkMessage
from gridpush_drake.station.scene.resolve import ResolvedScenario

Spoiler = Callable[[float, LinkMessage], list[LinkMessage]]
"""Of the twin's time, s, and a record: what comes instead."""


class SpoiledLink:
    """A link of which a test may change what is received."""

    def __init__(self, link: InProcessLink, read_time: Callable[[], float]) -> None:
        self.spoil: Spoiler | None = None
        self.send, self.get_name, self.place = link.send, link.get_name, link.place
        self._link, self._read_time = link, read_time

    def receive(self, timeout: float) -> list[LinkMessage]:
        messages = list(self._link.receive(timeout))
        if self.spoil is None:
            return messages
        return [each for one in messages for each in self.spoil(self._read_time(), one)]


class LinkBench:
    """Twin and task in one process and in lockstep; what the arm does is written down at every status.

    Attributes:
        links: the ends of control and of the twin; tests may spoil either.
        rows: (time, positions) of the twin's arm, s and rad.
    """

    def __init__(self, resolved: ResolvedScenario, task: type) -> None:
        at_control, at_twin = InProcessLink.make_pair()
        self.links = SpoiledLink(at_control, self.read_time), SpoiledLink(at_twin, self.read_time)
        others = len(resolved.others)
        self.twin_link = TwinLink(self.links[1], resolved.robot)
        self.twin = MakeTwin(resolved, at_twin.send)
        self.simulator = Simulator(self.twin)
        self.twin.SetStart(self.simulator.get_mutable_context())
        self.rows: list[tuple[float, np.ndarray]] = []
        self._count = 0
        called = resolved.scenario.names.name_others(others)
        self.link = HardwareLink(
            self.links[0], resolved.robot, others=called, robot=self.move, clock=self.read_clock
        )
        while not self.rows or any(each.record is None for each in self.link._objects):
            self.move()
            self.link._listen()
        self.task = task(resolved, make_station=MakeHardwareStation)
        self.link.armed = True

    def read_time(self) -> float:
        """The twin's time, s."""
        return float(self.simulator.get_context().get_time())

    def read_clock(self) -> float:
        """The observer's clock, s."""
        return self._count * ARM_PERIOD

    def move(self) -> None:
        """Moves the twin on by a period; its records go out, and commands come in."""
        self._count += 1
        self.twin_link.exchange(self.twin, self.simulator.get_mutable_context())
        self.simulator.AdvanceTo((self._count + 0.5) * ARM_PERIOD)
        plant, arm = self.twin.world.plant, self.twin.world.robot_in_plant.arm
        context = plant.GetMyContextFromRoot(self.simulator.get_context())
        self.rows.append((self.read_time(), plant.GetPositions(context, arm)))
