"""A twin and what moves it at the two ends of an `InProcessLink`; a test may spoil what passes along it."""

from collections.abc import Callable
from functools import partial

import numpy as np
from pydrake.systems.analysis import Simulator

from gridpush_drake.station.hardware.hardware_link import HardwareLink
from gridpush_drake.station.hardware.hardware_station import MakeHardwareStation
from gridpush_drake.station.hardware.twin import MakeTwin
from gridpush_drake.station.hardware.twin_link import TwinLink
from gridpush_drake.station.links.in_process import InProcessLink
from gridpush_drake.station.links.lcm.robot_messages import ARM_PERIOD
from gridpush_drake.station.links.link import LinkMessage
from gridpush_drake.station.links.link_bus import LinkBus
from gridpush_drake.station.resolve import ResolvedScenario

Spoiler = Callable[[float, LinkMessage], list[LinkMessage]]
"""Of the twin's time, s, and a record: what comes instead."""


class SpoiledLink:
    """A link of which a test may change what is received."""

    def __init__(self, link: InProcessLink, read_time: Callable[[], float]) -> None:
        self.spoil: Spoiler | None = None
        self.send = link.send
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
        bus = LinkBus(self.links[1], resolved.robot, others=others)
        self.twin_link = TwinLink(bus, resolved.robot, others)
        bus.leave_out = self.twin_link.leave_out
        self.twin = MakeTwin(resolved, self.twin_link.bus, listens=False)
        self.simulator = Simulator(self.twin)
        self.twin.SetStart(self.simulator.get_mutable_context())
        self.rows: list[tuple[float, np.ndarray]] = []
        self._count = 0
        bus = LinkBus(self.links[0], resolved.robot, others=others)
        called = resolved.scenario.names.name_others(others)
        self.link = HardwareLink(
            bus, resolved.robot, others=called, robot=self.move, clock=self.read_clock
        )
        bus.leave_out = self.link.leave_out
        while not self.rows or any(each.data is None for each in self.link._objects):
            self.move()
            bus.HandleSubscriptions(0)
        self.task = task(resolved, make_station=partial(MakeHardwareStation, lcm=self.link.bus))
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
        self.twin_link.exchange()
        self.simulator.AdvanceTo((self._count + 0.5) * ARM_PERIOD)
        self.twin_link.exchange()
        plant, arm = self.twin.world.plant, self.twin.world.robot_in_plant.arm
        context = plant.GetMyContextFromRoot(self.simulator.get_context())
        self.rows.append((self.read_time(), plant.GetPositions(context, arm)))
