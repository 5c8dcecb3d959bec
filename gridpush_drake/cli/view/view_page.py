"""The page that `gridpush view` shows a model, an object or pushes on, and how it is served."""

import os
import sys
import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any

from gridpush_drake.cli.shell import options
from gridpush_drake.cli.shell.console import print_found
from gridpush_drake.cli.view.view_log import describe_pushes, predict_pushes
from gridpush_drake.cli.view.view_scene import AddModel, AddPushes, describe_colors, make_overlay
from gridpush_drake.display.cell_colors import Shown
from gridpush_drake.display.live_page import LivePage
from gridpush_drake.display.overlay import Overlay
from gridpush_drake.display.server import PublishOnce
from gridpush_drake.objects.object_file import speak_name
from gridpush_drake.pushes.push_log import PushLog


@dataclass(frozen=True)
class ShownScene:
    """What is shown.

    Attributes:
        page: the page, on which everything has been drawn.
        overlay: the legend and the captions of the page.
        found: what is printed with `--json`.
        lines: what is printed without it.
    """

    page: LivePage
    overlay: Overlay
    found: dict[str, Any]
    lines: list[str]


@dataclass(frozen=True)
class PageStyle:
    """How it is shown.

    Attributes:
        shows: what the colors of the cells stand for.
        height: height of the object, m; None for its file's, or the default one.
        port: port of the page; None for the first free one from 7000 on, 0 for any.
    """

    shows: Shown
    height: float | None
    port: int | None


def describe_target(target: options.Target) -> dict[str, Any]:
    """Says for machines what is shown: a learned model, or only an object."""
    kind = "model" if target.model else "object"
    return {"kind": kind, "object": target.obj.name}


def open_recording(path: Path, open_page: bool, json: bool) -> None:
    """Opens a recording in the browser, or prints its address; it needs no server."""
    address = path.resolve().as_uri()
    opened = open_page and _open(address)
    line = f"{'Opened' if opened else 'Open this in a browser:'} {address}"
    found = {"kind": "recording", "url": address, "opened": opened, "written": []}
    print_found(found, [line], json)


def draw_model_page(target: options.Target, style: PageStyle) -> ShownScene:
    """Draws a model or an object at rest."""
    page = LivePage(style.port)
    AddModel(page.meshcat, target, style.shows, options.choose_height(style.height, target.obj))
    return ShownScene(
        page=page,
        overlay=make_overlay([target], style.shows),
        found=describe_target(target),
        lines=[
            f"{speak_name(target.obj.name)}: {target.obj.n} cells",
            describe_colors(style.shows),
        ],
    )


def draw_pushes_page(
    targets: Sequence[options.Target], picked: PushLog, style: PageStyle
) -> ShownScene:
    """Records a replay of pushes, beside their predictions if there is a learned model.

    Args:
        targets: the models or the objects that were pushed, in the order of the log's.
        picked: the pushes.
        style: how they are shown.
    """
    predictions = predict_pushes(targets, picked)
    page = LivePage(style.port)
    height = options.choose_height(style.height, targets[0].obj)
    AddPushes(page.meshcat, targets, picked, predictions, style.shows, height)

    found, lines = describe_pushes(targets, picked, predictions, style.shows)
    overlay = make_overlay(targets, style.shows, picked, predictions)
    return ShownScene(page=page, overlay=overlay, found=found, lines=lines)


def serve(scene: ShownScene, open_page: bool, json: bool) -> None:
    """Serves a page until the user ends the command."""
    url = scene.page.url
    # Whoever reads the address may interrupt at once, so everything from the first line on is
    # guarded
    try:
        PublishOnce(scene.page.meshcat)
        last = f"The page is at {url} (Enter or Ctrl-C ends it)"
        found = {**scene.found, "url": url, "written": []}
        print_found(found, [*scene.lines, last], json)
        if open_page:
            _open(url)
        _wait()
    except KeyboardInterrupt:
        pass


def _open(address: str) -> bool:
    """Opens a page in the desktop's browser. Returns False if there is none."""
    # Without a display Python would start a browser in the terminal itself, if it finds one.
    if sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        return False
    return webbrowser.open(address)


def _wait() -> None:
    """Waits for Enter at a terminal; without one, until the process is interrupted."""
    if sys.stdin is not None and sys.stdin.isatty():
        sys.stdin.readline()
    else:
        Event().wait()
