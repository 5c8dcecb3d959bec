"""`gridpush bench pregrasp`: slides to the table's edge, and pokes that are chosen to tell much."""

from typing import Annotated, Any, Literal

import typer

from gridpush_drake.bench.pregrasp.experiments import DEPTH, MASS_SETS, SEEDS, run
from gridpush_drake.bench.table import Table
from gridpush_drake.cli.bench.common import Masks, Objects, run_as_bench


@run_as_bench
def pregrasp(
    data: Masks = None,
    objects: Objects = None,
    mass_sets: Annotated[
        int | None, typer.Option(min=1, help="Hidden sets of masses and frictions an object.")
    ] = None,
    seeds: Annotated[
        int | None, typer.Option(min=1, help="Tables, starts and noises a set.")
    ] = None,
    depth: Annotated[
        float, typer.Option(help="Depth of the gripper's fingers, which must hang over, m.")
    ] = DEPTH,
    experiment: Annotated[
        Literal["all", "sliding", "exploring", "materials", "bounds"],
        typer.Option(
            help="What to measure: all stands for sliding and exploring; materials are objects of rubber and steel; "
            "bounds of the friction are judged by what they allow at best."
        ),
    ] = "all",
    truths: Annotated[
        list[str] | None,
        typer.Option(
            "--truth",
            metavar="TRUTH",
            help="What moves the objects, on rectangular tables: lcp, the model's own simulator, or MuJoCo bodies that "
            "stand as own_weight, half_height, foundation, vertices or three_feet, or MODULE:CLASS of a world of "
            "your own; may be repeated.",
            show_default="the model's own simulator, on any table",
        ),
    ] = None,
    max_arm: Annotated[
        float,
        typer.Option(help="How far from its believed center of mass an object may be taken, m."),
    ] = 0.06,
    friction: Annotated[
        tuple[float, float],
        typer.Option(
            metavar="LEAST GREATEST",
            help="Bounds of the friction of any part against the table, true and known.",
        ),
    ] = (0.3, 0.4),
    **common: Any,
) -> list[Table]:
    """Slide objects of hidden masses to the table's edge, and compare pokes by design with random ones."""
    return run(
        objects, mass_sets or MASS_SETS, seeds or SEEDS, depth=depth, experiment=experiment, data=data,
        friction=friction, truths=truths, max_arm=max_arm, **common,
    )  # fmt: skip
