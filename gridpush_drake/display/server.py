"""Meshcat: started with clear errors, and its recordings written."""

import gc
import logging
from math import cos, sin
from pathlib import Path
from threading import get_ident
from typing import Any
from weakref import ref

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Meshcat, MeshcatAnimation, MeshcatParams

from gridpush_drake.display.overlay import Overlay, add_overlay
from gridpush_drake.errors import StationError
from gridpush_drake.files import check_writable, read_head, write_whole
from gridpush_drake.geometry.se2 import make_direction

MIN_PORT = 1024
"""Smallest port that a user may listen on; those below belong to the system."""

MAX_PORT = 65535
"""Largest port."""

LAYERS_TO_LEAVE_OUT = ("/drake/proximity", "/drake/contact_forces", "/drake/inertia")
"""Layers that a recording does not show: collision geometry, contact forces, inertia ellipsoids."""

CAMERA_AZIMUTH = -1.75
"""Angle about the vertical at which the camera stands as seen from its target, rad: before the
table, a little to the left."""

CAMERA_ELEVATION = 0.85
"""Angle above the table at which the camera stands as seen from its target, rad."""

MESHCAT_MARK = b"<title>Drake MeshCat</title>"
"""Text that stands in every page of Meshcat."""

MARK_ROOM = 4096
"""Number of bytes at the beginning of a page within which `MESHCAT_MARK` stands."""

BACKGROUND_TOP = (0.97, 0.975, 0.98)
"""Color of the background's upper end, sRGB, 0 to 1."""

BACKGROUND_BOTTOM = (0.80, 0.82, 0.85)
"""Color of the background's lower end, sRGB, 0 to 1."""

LIGHT_INTENSITIES = {"AmbientLight": 1.2, "PointLightNegativeX": 14.0, "PointLightPositiveX": 14.0}
"""Intensities of lights that show a horizontal face near the origin in its own color. Meshcat's own
make it a third brighter."""

_STARTED: list[tuple["ref[Meshcat]", int]] = []
"""Each server and the thread that started it."""

_HELD: list[Meshcat] = []
"""Servers that the thread which collects garbage must not destroy."""


def StartMeshcatServer(port: int | None = None, host: str = "localhost") -> Meshcat:
    """Starts Meshcat, with a light background and neither grid nor axes; `web_url()` is its page.

    Args:
        port: to listen on; the first free one from 7000 on where None, any free one where 0.
        host: to listen on: "localhost" for this machine alone, "*" for every network it is in.

    Raises:
        StationError: the port is out of range or in use, or the host is not this machine's.
    """
    check_port(port)
    params = MeshcatParams(host=host, port=port, show_stats_plot=False)
    log = logging.getLogger("drake")
    level = log.level
    log.setLevel(logging.WARNING)  # whoever starts it says where its page is
    try:
        meshcat = Meshcat(params)
    except RuntimeError as error:
        raise StationError(explain_port(port, host)) from error
    finally:
        log.setLevel(level)
    ApplySceneStyle(meshcat)
    KeepToItsThread(meshcat)
    return meshcat


def check_port(port: int | None) -> None:
    """Refuses a port that is neither None or 0, for any free one, nor one of a user's.

    Raises:
        StationError: it is none of these.
    """
    if port is not None and port != 0 and not MIN_PORT <= port <= MAX_PORT:
        raise StationError(
            f"port is {port}; expected one from {MIN_PORT} to {MAX_PORT}, or 0 for any free one"
        )


def explain_port(port: int | None, host: str) -> str:
    """Says why a port cannot be listened on, and what to do."""
    if port:
        return (
            f"port {port} cannot be listened on at {host!r}: it is in use already, or {host!r} is "
            "not this machine's "
            "address; end the program that uses it, or pass another port (0 takes any free one)"
        )
    return (
        f"Meshcat cannot listen at {host!r}: expected this machine's name or address, such as "
        "'localhost' or '*'"
    )


def KeepToItsThread(meshcat: Meshcat) -> None:
    """Has a server destroyed by this thread only, which must be the one that started it.

    A thread that was named for the same server before stays the one.

    Drake ends the process where another thread destroys it, as a worker's does that happens to
    collect the garbage in which a dropped Diagram's server lies.
    """
    _STARTED[:] = [one for one in _STARTED if one[0]() is not None]
    if all(made() is not meshcat for made, _ in _STARTED):
        _STARTED.append((ref(meshcat), get_ident()))
    if _hold_others not in gc.callbacks:
        gc.callbacks.append(_hold_others)


def ApplySceneStyle(meshcat: Meshcat) -> None:
    """Gives a scene a light background and even light, and takes its grid and axes away."""
    for light, intensity in LIGHT_INTENSITIES.items():
        meshcat.SetProperty(f"/Lights/{light}/<object>", "intensity", intensity)
    meshcat.SetProperty("/Background", "top_color", list(BACKGROUND_TOP))
    meshcat.SetProperty("/Background", "bottom_color", list(BACKGROUND_BOTTOM))
    for path in ("/Grid", "/Axes"):
        meshcat.SetProperty(path, "visible", False)


def AimCamera(
    meshcat: Meshcat,
    target: ArrayLike,
    distance: float,
    azimuth: float = CAMERA_AZIMUTH,
    elevation: float = CAMERA_ELEVATION,
) -> None:
    """Points the camera at a place (3,) in W, m, from a distance, m.

    Azimuth (rad from the x axis) and elevation (rad from the table) are the camera's, as seen from
    that place.
    """
    direction = [*cos(elevation) * make_direction(azimuth), sin(elevation)]
    p_WT: Any = np.asarray(target, dtype=np.float64)
    p_WC: Any = p_WT + distance * np.array(direction)
    meshcat.SetCameraPose(p_WC, p_WT)


def PublishOnce(meshcat: Meshcat) -> None:
    """Publishes what was recorded, to be played once and to stay on its last frame.

    In a loop each thing that moves would begin anew when its own last change is over, and they
    would not keep time.
    """
    meshcat.StopRecording()
    recording = meshcat.get_mutable_recording()
    recording.set_loop_mode(MeshcatAnimation.LoopMode.kLoopOnce)
    recording.set_clamp_when_finished(True)
    meshcat.PublishRecording()


def write_recording(
    meshcat: Meshcat, path: Path | str, force: bool = False, overlay: Overlay | None = None
) -> None:
    """Writes the scene, with what was recorded, as one self-contained HTML file.

    It plays when it is opened. The recording is stopped and published, and `LAYERS_TO_LEAVE_OUT`
    are deleted from the scene.

    Raises:
        OutputError: the file exists and `force` is not set, or it cannot be written.
    """
    check_writable(path, force)
    for layer in LAYERS_TO_LEAVE_OUT:
        meshcat.Delete(layer)
    PublishOnce(meshcat)
    page = meshcat.StaticHtml()
    write_whole(path, page if overlay is None else add_overlay(page, overlay), force)


def looks_like_recording(path: Path | str) -> bool:
    """Whether a file is a page that Meshcat wrote; False where it cannot be read."""
    return MESHCAT_MARK in read_head(path, MARK_ROOM)


def _hold_others(phase: str, _: dict[str, int]) -> None:
    """Before a thread collects garbage, holds the servers of the others, and lets go of its own."""
    if phase == "start":
        here = get_ident()
        _HELD[:] = [
            meshcat
            for made, thread in _STARTED
            if thread != here and (meshcat := made()) is not None
        ]
