"""`gridpush campaign`: runs the demo many times, and counts how the runs ended."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from gridpush_drake.cli.run.demo import Task
from gridpush_drake.cli.run.unknown_inertia import UnknownInertia, hide_inertia
from gridpush_drake.cli.shell import options
from gridpush_drake.cli.shell.console import print_json, print_line, print_table
from gridpush_drake.errors import GridPushError, ObjectError
from gridpush_drake.files import exists, make_folder, read_bytes, read_text, write_whole
from gridpush_drake.jobs.results import Results, hash_content, open_results
from gridpush_drake.objects.object_file import list_shipped_objects
from gridpush_drake.station.campaign.episodes import (
    EPISODES_FILE,
    RECORDINGS_FOLDER,
    SCENARIO_FILE,
    TABLE_FILE,
    describe_settings,
    drop_recordings,
    run,
)
from gridpush_drake.station.recording.run_recorder import import_rosbags
from gridpush_drake.station.robot.robot import make_robot_directives
from gridpush_drake.station.scene.contents import use_object
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.schema.scenario import MAX_SEED, PushScenario
from gridpush_drake.station.schema.scenario_file import format_scenario, read_scenario
from gridpush_drake.station.schema.task_table import DEFAULT_TASK
from gridpush_drake.station.tasks.registry import TASK_KINDS
from gridpush_drake.yaml_file import shorten

MAX_EPISODES = 1_000_000
"""Largest number of episodes in one campaign."""

MAX_DIGITS = 30
"""Most digits that the number of a seed may have; Python needs long to read very long ones."""

SEEDS_FORM = (
    "START:STOP (without STOP), or numbers, 0 or more, with commas between, such as 0:1000 or "
    "3,17,20:30"
)
"""The form of seeds on the command line."""


def campaign(
    scenario_file: Annotated[
        Path,
        typer.Argument(
            metavar="SCENARIO_FILE",
            help="What stands where: a shipped scenario's name, such as grasp, or a YAML file.",
            show_default=False,
        ),
    ],
    seeds: Annotated[
        str,
        typer.Option(
            metavar="START:STOP",
            help=f"Seeds of the episodes: {SEEDS_FORM}. With each seed one episode is run for "
            "every "
            "object.",
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            help="Folder of the campaign. A campaign that was broken off goes on there: episodes "
            "that it holds are not run again. If it holds a campaign of another scenario, the "
            "command refuses, and --force begins anew.",
        ),
    ],
    objects: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,NAME",
            help="Shipped objects' names or object files, with commas between.",
            show_default="the scenario's",
        ),
    ] = None,
    task: Task = DEFAULT_TASK,
    robot: options.RobotScene = None,
    camera: Annotated[
        Literal["ideal", "rgbd"] | None,
        typer.Option(
            help="What the robot sees; `gridpush demo --help` explains it.",
            show_default="the scenario's",
        ),
    ] = None,
    unknown_inertia: UnknownInertia = False,
    record: Annotated[
        bool,
        typer.Option(
            "--record",
            help=f"Write each episode as an MCAP file with standard ROS 2 messages, for Foxglove, "
            f"too, to the folder {RECORDINGS_FOLDER} in DIR. Episodes that DIR holds without a "
            "recording "
            "are run again.",
        ),
    ] = False,
    workers: options.Workers = options.DEFAULT_WORKERS,
    dask: options.Dask = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Run the demo many times, with many seeds and objects, and count how the runs ended.

    A run is called an episode. The command counts how many episodes ended with the object held,
    dropped or given up, and why. It writes scenario.yaml, episodes.jsonl (one line for each
    episode, as soon as it ends) and table.md, and with --record a recording of each episode.

    Example: gridpush campaign grasp --seeds 0:20 --objects claw_hammer,pliers --out campaign
    """
    if record:
        if dask is not None:
            raise options.OptionError(
                "--record: goes with workers on this computer only, as they write the recordings; "
                "expected no --dask"
            )
        import_rosbags()
    scenario = read_scenario(scenario_file)
    if camera is not None:
        scenario.camera.use(camera)
    if unknown_inertia:
        hide_inertia(scenario, task)
    if robot is not None:
        scenario.directives = make_robot_directives(
            robot, grasping=TASK_KINDS[task].grasps, pusher=scenario.pusher
        )
    chosen = _find_objects(scenario, objects)
    numbers = parse_seeds("--seeds", seeds, MAX_EPISODES // len(chosen))
    # an object that does not fit the scenario or the task is refused now, not after hours
    for name in chosen:
        trial = scenario.model_copy()
        TASK_KINDS[task].check(
            resolve(trial, scenario_file, known_object=use_object(trial, name, "--objects"))
        )

    def begin() -> Results:
        make_folder(out)
        results = open_results(
            out / EPISODES_FILE, "campaign", describe_settings(task, scenario), force
        )
        if force:
            drop_recordings(out)
        path = out / SCENARIO_FILE
        text = format_scenario(scenario)
        if force or not exists(path):
            write_whole(path, text, force)
        elif read_text(path, "a scenario", GridPushError) != text:
            raise GridPushError(
                f"{path}: differs from the scenario given; expected the same scenario, another "
                "--out, or --force to begin anew"
            )
        return results

    with options.executing("campaign", workers, dask, begin) as execution:
        found = run(task, scenario, chosen, numbers, out, execution, record)
    table = found.tabulate()
    write_whole(out / TABLE_FILE, table.to_markdown(), force=True)
    if json:
        print_json(found.to_dict())
        return
    print_table(table)
    recordings = f", {RECORDINGS_FOLDER}" if record else ""
    print_line(f"\nIn {out}: {SCENARIO_FILE}, {EPISODES_FILE}, {TABLE_FILE}{recordings}.")


def parse_seeds(option: str, text: str, most: int) -> list[int]:
    """Reads the seeds of a campaign.

    Args:
        option: the option's name, for the error's message.
        text: what the user wrote; see FORM.
        most: the largest number of seeds that is allowed.

    Returns:
        The seeds, each once, in increasing order.

    Raises:
        OptionError: the text is of another form, or there are no seeds or too many.
    """
    ranges = []
    for part in text.split(","):
        start, colon, stop = part.partition(":")
        numbers = [start, stop] if colon else [start]
        if not all(map(_is_number, numbers)):
            raise options.OptionError(f"{option}: is {shorten(text)}; expected {SEEDS_FORM}")
        ranges.append(range(int(start), int(stop) if colon else int(start) + 1))
    # by the ends of the ranges, for a range may be far too long to be gone through
    is_bad_range = any(not each or each[-1] > MAX_SEED for each in ranges)
    count = sum(each.stop - each.start for each in ranges)
    if is_bad_range or count > most:
        raise options.OptionError(
            f"{option}: is {shorten(text)}; expected at least one seed in each range, none over "
            f"{MAX_SEED}, and at most {most} seeds"
        )
    return sorted({seed for each in ranges for seed in each})


def _is_number(text: str) -> bool:
    """Returns whether a text is a whole number, 0 or more, of ordinary digits."""
    return text.isdecimal() and text.isascii() and len(text) <= MAX_DIGITS


def _find_objects(scenario: PushScenario, names: str | None) -> dict[str, str]:
    """Finds the objects of a campaign.

    Returns:
        Of each object the name of a shipped one, with "", or the full path of its file, with the
        hash of the file's content. The hash tells whether the file was changed between two runs.
    """
    found = {}
    for name in [scenario.object] if names is None else names.split(","):
        if not name:
            raise options.OptionError(
                f"--objects: is {names!r}; expected names with commas between, none of them empty"
            )
        path = options.object_path(name)
        if name in list_shipped_objects() and not exists(name):
            found[name] = ""
        else:
            found[str(path.resolve())] = hash_content(
                read_bytes(path, "an object file", ObjectError)
            )
    return found
