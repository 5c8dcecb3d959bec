"""`TwinCamera`: a twin's color and depth camera, and the process that sends its pictures.

A pair of pictures takes longer to render than the arm's period of 5 ms. So it is rendered in
another process: the twin tells that process where all joints and the object are, and goes on.
"""

import multiprocessing
import signal
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

from numpy.typing import ArrayLike
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.errors import StationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.perception.images.frames import Frame
from gridpush_drake.station.links.link import Link
from gridpush_drake.station.scene.camera import AddRgbdCamera
from gridpush_drake.station.scene.other_objects import list_parts
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.schema.scenario_file import format_scenario, parse_scenario
from gridpush_drake.station.simulated.plant import AddWorld

ENDS_WITHIN = 5.0
"""Longest time that the process may take to end once nothing is asked of it any more, s."""

TWINS_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
"""Names of the signals that the process ignores. They reach the twin as well, which then closes the
pipe, and the process ends in good order. Windows has no SIGHUP."""


class TwinCamera:
    """A scenario's camera before a world that is told its positions; nothing moves by itself."""

    def __init__(self, scenario: PushScenario) -> None:
        """Makes the world and the camera.

        Args:
            scenario: a scenario with a color and depth camera; it is not changed.

        Raises:
            ScenarioError: the scenario makes no sense.
            StationError: nothing can be rendered on this computer.
        """
        builder = DiagramBuilder()
        resolved = resolve(scenario.model_copy(deep=True))
        world = AddWorld(builder, resolved, is_known=bool(resolved.others))
        camera = AddRgbdCamera(
            builder,
            world.plant,
            world.scene_graph,
            scenario=world.setting.scenario,
            parts=[world.object_in_plant, *list_parts(world.setting.others)],
        )
        self._plant = world.plant
        self._noise = camera.noise
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()

    def take(self, t: float, q: ArrayLike) -> Frame:
        """Takes the picture of a moment.

        Args:
            t: time, s.
            q: (n,) positions of the twin's plant at this time.

        Returns:
            Color and depth, with the camera's noise, which depends on the scenario's seed and on t.
        """
        self._context.SetTime(t)
        self._plant.SetPositions(self._plant.GetMyMutableContextFromRoot(self._context), q)
        own = self._noise.GetMyContextFromRoot(self._context)
        color = self._noise.GetOutputPort("color_image").Eval(own).data
        depth = self._noise.GetOutputPort("depth_image").Eval(own).data
        return Frame(color[..., :3].copy(), depth[..., 0].copy(), t)


class PictureProcess:
    """A process that renders what a twin's camera sees, and says it."""

    def __init__(self, scenario: PushScenario, open_link: Callable[[], Link]) -> None:
        """Starts the process.

        Args:
            scenario: the twin's scenario.
            open_link: opens the link of the pictures in that process; it can be pickled.
        """
        # Not a fork, which would leave out pydrake's threads.
        context = multiprocessing.get_context("spawn")
        listener, self._asks = context.Pipe(duplex=False)
        work = (format_scenario(scenario), open_link, listener)
        self._process = context.Process(target=_take_pictures, args=work, daemon=True)
        self._process.start()
        listener.close()

    def ask(self, t: float, q: Array) -> None:
        """Asks for the picture of a moment, which is left out if a newer one is asked for in time.

        Args:
            t: time, s.
            q: (n,) positions of the twin's plant at this time.

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


def _take_pictures(scenario: str, open_link: Callable[[], Link], asks: Connection) -> None:
    """Takes pictures until the pipe is closed: the work of a `PictureProcess`.

    Args:
        scenario: text of the scenario's YAML file.
        open_link: opens the link over which the pictures go.
        asks: the end of the pipe from which times and positions come.
    """
    for name in TWINS_SIGNALS:
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    link = open_link()
    camera = TwinCamera(parse_scenario(Path("scenario.yaml"), scenario))
    try:
        while True:
            t, q = asks.recv()
            while asks.poll():  # only the newest is answered
                t, q = asks.recv()
            link.send(camera.take(t, q))
    except EOFError:
        return
