"""`gridpush tracker`: where the object is, from a camera's pictures on LCM."""

from pathlib import Path
from time import monotonic
from typing import Annotated

import typer

from gridpush_drake.cli import options
from gridpush_drake.cli.console import MM, print_line, print_notice
from gridpush_drake.cli.twin import DEFAULT_URL, LcmUrl, Scenario, read_robot_scenario
from gridpush_drake.files import check_writable, write_whole
from gridpush_drake.objects.object_file import dump_object
from gridpush_drake.station.lcm.hardware_link import open_lcm
from gridpush_drake.station.lcm.picture_tracker import PictureTracker
from gridpush_drake.station.lcm.robot_messages import OBJECT_STATUS
from gridpush_drake.station.resolve import resolve

WAIT = 0.1
"""Longest time that messages are waited for between two looks at whether to end, s."""

PATIENCE = 5.0
"""Time without a usable picture, s, after which it is said what is missing."""


def tracker(
    scenario_file: Scenario = None,
    object_file: Annotated[
        str | None,
        typer.Option(
            "--object",
            metavar="NAME|FILE",
            help="Follow this object.  [default: what is found in the first picture]",
        ),
    ] = None,
    lcm: LcmUrl = DEFAULT_URL,
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", metavar="OBJECT.yaml", help="Where the object that is found is written."
        ),
    ] = Path("object.yaml"),
    force: options.Force = False,
) -> None:
    """Find an object in a camera's LCM pictures and tell `gridpush robot` where it is; Ctrl-C ends it."""
    scenario, obj = read_robot_scenario(scenario_file, object_file, None)
    resolved = resolve(scenario, scenario_file, told=obj)
    if object_file is None:
        check_writable(out, force)
    given = None if object_file is None else resolved.obj
    follower = PictureTracker(resolved, open_lcm(lcm), given)
    print_notice(f"Looking for pictures on {lcm}; Ctrl-C ends it.")
    try:
        _find(follower, out if given is None else None, force)
        print_notice(f"Its pose is said on {OBJECT_STATUS}.")
        _follow(follower)
    except KeyboardInterrupt:
        print_notice(f"{follower.report.describe()}.")


def _follow(follower: PictureTracker) -> None:
    """Looks for as long as the command runs; says when no picture could be used for a while, and why."""
    last, told = monotonic(), False
    while True:
        before = follower.report.left_out.copy()
        tracked = follower.step(WAIT)
        if tracked is not None:
            last, told = monotonic(), False
        elif not told and monotonic() - last > PATIENCE:
            new = follower.report.left_out - before
            reasons = "; ".join(new) or "no picture and status of the robot came"
            print_notice(f"No pose is said any more: for {PATIENCE:g} s {reasons}.")
            told = True


def _find(follower: PictureTracker, out: Path | None, force: bool) -> None:
    """Looks until the object is seen, and says what is in the way; writes what was found."""
    begin, said = monotonic(), ""
    while True:
        tracked = follower.step(WAIT)
        if tracked is not None and tracked.seen:
            break
        why = follower.find_obstacle()
        if why and why != said and monotonic() - begin > PATIENCE:
            print_notice(f"Not yet: {why}.")
            said = why
    obj, (x, y, theta) = follower.obj, tracked.pose
    assert obj is not None  # it is seen
    where = f"at ({x:.3f}, {y:.3f}) m, turned by {theta:.2f} rad"
    if out is None:
        print_line(f"{obj.name} is seen {where}.")
        return
    write_whole(out, dump_object(obj.name, obj.grid, obj.prior, obj.height), force)
    print_line(
        f"An object of {obj.n} cells, {MM * (obj.height or 0.0):.0f} mm high, is seen {where}. Wrote {out}."
    )
