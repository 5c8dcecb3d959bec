"""`gridpush tracker`: finds objects in a camera's pictures, and tells where they are."""

from pathlib import Path
from time import monotonic
from typing import Annotated

import typer

from gridpush_drake.cli.run.open_link import ByRos2, LcmUrl, open_link
from gridpush_drake.cli.run.twin import DEFAULT_SCENARIO, Scenario, read_robot_scenario
from gridpush_drake.cli.shell import options
from gridpush_drake.cli.shell.console import PLACE_FORMAT, print_line, print_notice
from gridpush_drake.files import check_writable, write_whole
from gridpush_drake.objects.object_file import OBJECT_FILE, dump_object
from gridpush_drake.station.hardware.picture_tracker import PictureTracker
from gridpush_drake.station.links.lcm.lcm_address import DEFAULT_URL
from gridpush_drake.station.links.link import LinkRole
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.systems.robot_records import PoseObservation
from gridpush_drake.units import MM_PER_M

MAX_MESSAGE_WAIT = 0.1
"""Longest time that the loop waits for a message before it looks whether it should end, s."""

MAX_PICTURE_GAP = 5.0
"""If no picture could be used for this long, the user is told what is missing, s."""


def tracker(
    scenario_file: Scenario = None,
    object_file: Annotated[
        str | None,
        typer.Option(
            "--object",
            metavar="NAME|FILE",
            help="The object to follow: a shipped object's name, or an object file.",
            show_default="what is found in the first picture",
        ),
    ] = None,
    lcm: LcmUrl = DEFAULT_URL,
    ros2: ByRos2 = False,
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            "-o",
            metavar="OBJECT.yaml",
            help="The object file to write, for what is found in the first picture.",
        ),
    ] = Path(OBJECT_FILE),
    force: options.Force = False,
) -> None:
    """Find an object in a camera's pictures, and tell `gridpush robot` where it is.

    If the scenario has other objects, all of them are found and followed, by the outlines that
    their files have.

    The pictures come from the camera's driver or from `gridpush twin`, over LCM or ROS 2. The
    command runs until Ctrl-C ends it.

    Example: gridpush tracker --scenario cell.yaml --out object.yaml
    """
    scenario, obj = read_robot_scenario(scenario_file, object_file, None)
    resolved = resolve(scenario, scenario_file or DEFAULT_SCENARIO, known_object=obj)
    # Several objects are told apart by their outlines, which the scenario names.
    is_given = object_file is not None or bool(resolved.others)
    if not is_given:
        check_writable(out, force)
    given = resolved.obj if is_given else None
    network = open_link(LinkRole.TRACKER, resolved, ros2, lcm)
    follower = PictureTracker(resolved, network, given)
    print_notice(f"Looking for pictures on {network.where}; Ctrl-C ends it.")
    try:
        _find(follower, out if given is None else None, force)
        kind = "topic" if ros2 else "LCM channel"
        for number in range(1 + len(resolved.others)):
            name = network.get_name(PoseObservation, number)
            print_notice(f"Its pose is sent on the {kind} {name}.")
        _follow(follower)
    except KeyboardInterrupt:
        print_notice(f"{follower.report.describe()}.")
    finally:
        network.close()


def _follow(follower: PictureTracker) -> None:
    """Follows the object until the command is ended.

    If no picture could be used for a while, it prints once why.
    """
    last_pose = monotonic()
    reported = False
    while True:
        before = follower.report.left_out.copy()
        tracked = follower.step(MAX_MESSAGE_WAIT)
        if tracked is not None:
            last_pose = monotonic()
            reported = False
        elif not reported and monotonic() - last_pose > MAX_PICTURE_GAP:
            new = follower.report.left_out - before
            reasons = "; ".join(new) or "no picture and no status of the robot came"
            print_notice(f"No pose has been sent for {MAX_PICTURE_GAP:g} s: {reasons}.")
            reported = True


def _find(follower: PictureTracker, out: Path | None, force: bool) -> None:
    """Looks at pictures until the object is seen, and prints what is in the way.

    Args:
        follower: what looks.
        out: the object file to write; None if the object is known beforehand.
        force: whether an existing file may be replaced.
    """
    begin = monotonic()
    said = ""
    while True:
        poses = follower.step_all(MAX_MESSAGE_WAIT)
        if poses and all(tracked.seen for tracked in poses):
            break
        why = follower.find_obstacle()
        if why and why != said and monotonic() - begin > MAX_PICTURE_GAP:
            print_notice(f"Not yet: {why}.")
            said = why
    obj = follower.obj
    assert obj is not None  # it is seen
    places = []
    for tracked in poses:
        place = PLACE_FORMAT.format(*tracked.pose)
        places.append(f"at {place}")
    if out is None:
        for name, where in zip(follower.names, places, strict=True):
            print_line(f"{name} is seen {where}.")
        return
    where = places[0]
    write_whole(out, dump_object(obj.name, obj.grid, obj.prior, obj.height), force)
    height = MM_PER_M * (obj.height or 0.0)
    print_line(f"An object of {obj.n} cells, {height:.0f} mm high, is seen {where}. Wrote {out}.")
