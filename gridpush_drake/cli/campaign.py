"""`gridpush campaign`: whole episodes with many seeds and objects, and how safe the robot is."""

from pathlib import Path
from typing import Annotated

import typer

from gridpush_drake.bench.campaign import EPISODES, SCENARIO, TABLE, describe_settings, run
from gridpush_drake.bench.jobs import Results, hash_content, open_results
from gridpush_drake.cli import options
from gridpush_drake.cli.console import print_json, print_line, print_table
from gridpush_drake.errors import GridPushError, ObjectError
from gridpush_drake.files import exists, make_folder, read_bytes, read_text, write_whole
from gridpush_drake.objects.object_file import list_shipped_objects
from gridpush_drake.station.resolve import resolve
from gridpush_drake.station.scenario import MAX_SEED, PushScenario
from gridpush_drake.station.scenario_file import format_scenario, read_scenario
from gridpush_drake.station.scene import use_object
from gridpush_drake.station.tasks import TaskName
from gridpush_drake.yaml_file import shorten

MAX_EPISODES = 1_000_000
"""Of a campaign."""

MAX_DIGITS = 30
"""Of a seed's number."""

FORM = "START:STOP (without STOP), or numbers, 0 or more, with commas between, such as 0:1000 or 3,17,20:30"


def campaign(
    scenario_file: Annotated[
        Path,
        typer.Argument(
            metavar="SCENARIO",
            help="What stands where: a shipped scenario's name, such as grasp, or a YAML file.",
            show_default=False,
        ),
    ],
    seeds: Annotated[
        str, typer.Option(metavar="START:STOP", help=f"Seeds of the episodes, each run with every object: {FORM}.")
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", metavar="DIR", help="Folder of the campaign. Episodes that are there are not run again; one"
            " of another scenario is refused, and --force begins it anew.",
        ),
    ],
    objects: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,NAME", help="Shipped objects' names or object files, with commas between.",
            show_default="the scenario's",
        ),
    ] = None,
    task: Annotated[TaskName, typer.Option(help="What the robot is to do; see gridpush demo.")] = TaskName.pregrasp,
    workers: options.Workers = options.WORKERS,
    dask: options.Dask = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:  # fmt: skip
    """Run whole episodes with many seeds and objects: how many are held, dropped, given up, and why.

    Writes scenario.yaml, episodes.jsonl (a line for each episode, as soon as it ends) and table.md.
    """
    scenario = read_scenario(scenario_file)
    chosen = _find_objects(scenario, objects)
    numbers = parse_seeds("--seeds", seeds, MAX_EPISODES // len(chosen))
    for name in chosen:
        trial = scenario.model_copy()
        resolve(trial, scenario_file, told=use_object(trial, name))

    def begin() -> Results:
        make_folder(out)
        results = open_results(out / EPISODES, "campaign", describe_settings(task, scenario), force)
        path, text = out / SCENARIO, format_scenario(scenario)
        if force or not exists(path):
            write_whole(path, text, force)
        elif read_text(path, "a scenario", GridPushError) != text:
            raise GridPushError(
                f"{path}: differs from the scenario given; expected the same, another --out, or --force to begin anew"
            )
        return results

    with options.executing("campaign", workers, dask, begin) as execution:
        found = run(task, scenario, chosen, numbers, out, execution)
    table = found.tabulate()
    write_whole(out / TABLE, table.to_markdown(), force=True)
    if json:
        print_json(found.to_dict())
        return
    print_table(table)
    print_line(f"\nIn {out}: {SCENARIO}, {EPISODES}, {TABLE}.")


def parse_seeds(option: str, text: str, most: int) -> list[int]:
    """Reads seeds as FORM says: each once, in order, and at most so many.

    Raises:
        OptionError: the text is something else, or there are none or too many.
    """
    ranges = []
    for part in text.split(","):
        start, colon, stop = part.partition(":")
        numbers = [start, stop] if colon else [start]
        if not all(
            number.isdecimal() and number.isascii() and len(number) <= MAX_DIGITS
            for number in numbers
        ):
            raise options.OptionError(f"{option}: is {shorten(text)}; expected {FORM}")
        ranges.append(range(int(start), int(stop) if colon else int(start) + 1))
    if (
        any(not each or each[-1] > MAX_SEED for each in ranges)
        or sum(each.stop - each.start for each in ranges) > most
    ):
        raise options.OptionError(
            f"{option}: is {shorten(text)}; expected at least one seed in each range, none over {MAX_SEED}, and at "
            f"most {most}"
        )
    return sorted({seed for each in ranges for seed in each})


def _find_objects(scenario: PushScenario, names: str | None) -> dict[str, str]:
    """Shipped objects' names, with "", and object files in full, with their content's hash."""
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
