"""`TwinCamera`: the pictures of a twin's color and depth camera, and the process that says them on a network.

A pair of pictures takes longer to render than the arm's period of 5 ms. So it is rendered
elsewhere: the twin hands on where all joints and the object are, and goes on.
"""

import multiprocessing
import signal
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

from drake import lcmt_image_array
from numpy.typing import ArrayLike
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.errors import StationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.perception.frames import Frame
from gridpush_drake.station.camera import AddRgbdCamera
from gridpush_drake.station.lcm.bus import Bus
from gridpush_drake.station.lcm.picture_messages import encode_frame
from gridpush_drake.station.lcm.robot_messages import PICTURES
from gridpush_drake.station.push_station import AddWorld
from gridpush_drake.station.resolve import resolve
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.scenario_file import format_scenario, parse_scenario

ENDS_WITHIN = 5.0
"""Longest time that the process may take to end once nothing is asked of it any more, s."""

TWINS_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
"""Signals that go to the twin as well, which then closes the pipe; Windows has no SIGHUP."""


class TwinCamera:
    """The camera of a scenario, before a world whose positions it is told; nothing moves by itself."""

    def __init__(self, scenario: PushScenario) -> None:
        """Makes the world and the camera.

        Args:
            scenario: with a color and depth camera, which is not changed.

        Raises:
            ScenarioError: it makes no sense.
            StationError: nothing can be rendered here.
        """
        builder = DiagramBuilder()
        world = AddWorld(builder, resolve(scenario.model_copy(deep=True)))
        setting, part = world.setting, world.object_in_plant
        camera = AddRgbdCamera(builder, world.plant, world.scene_graph, setting.scenario, part)
        self._plant, self._noise = world.plant, camera.noise
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()
        self._count = 0

    def take(self, t: float, q: ArrayLike) -> Frame:
        """Takes the picture of a moment.

        Args:
            t: when, s.
            q: (n,) positions of the twin's plant.

        Returns:
            Color and depth, with the camera's noise, which depends on the scenario's seed and on t.
        """
        self._context.SetTime(t)
        self._plant.SetPositions(self._plant.GetMyMutableContextFromRoot(self._context), q)
        own = self._noise.GetMyContextFromRoot(self._context)
        color, depth = (
            self._noise.GetOutputPort(name).Eval(own).data
            for name in ("color_image", "depth_image")
        )
        return Frame(color[..., :3].copy(), depth[..., 0].copy(), t)

    def make_message(self, t: float, q: ArrayLike) -> lcmt_image_array:
        """The picture of a moment, see `take`, as a message."""
        self._count += 1
        return encode_frame(self.take(t, q), self._count - 1)


class PictureProcess:
    """A process that renders what a twin's camera sees, and says it."""

    def __init__(self, scenario: PushScenario, open_bus: Callable[[], Bus]) -> None:
        """Starts the process.

        Args:
            scenario: of the twin.
            open_bus: opens, in that process, what the pictures are said on; it can be pickled.
        """
        context = multiprocessing.get_context(
            "spawn"
        )  # pydrake has threads, which a fork would not survive
        listener, self._asks = context.Pipe(duplex=False)
        work = (format_scenario(scenario), open_bus, listener)
        self._process = context.Process(target=_take_pictures, args=work, daemon=True)
        self._process.start()
        listener.close()

    def ask(self, t: float, q: Array) -> None:
        """Wants the picture of a moment; one that it comes too late for is left out.

        Raises:
            StationError: the process has ended.
        """
        try:
            self._asks.send((t, q))
        except OSError as error:
            raise StationError("the twin's camera has ended; nothing is seen any more") from error

    def close(self) -> None:
        """Ends the process."""
        self._asks.close()
        self._process.join(ENDS_WITHIN)
        if self._process.is_alive():
            self._process.kill()


def _take_pictures(scenario: str, open_bus: Callable[[], Bus], asks: Connection) -> None:
    """Answers the newest of what is asked, until nobody can ask any more; the scenario is YAML."""
    for name in TWINS_SIGNALS:
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    bus, camera = open_bus(), TwinCamera(parse_scenario(Path("scenario.yaml"), scenario))
    try:
        while True:
            t, q = asks.recv()
            while asks.poll():
                t, q = asks.recv()
            bus.Publish(PICTURES, camera.make_message(t, q).encode())
    except EOFError:
        return
