"""`gridpush bench gym`: the Gymnasium environments."""

from typing import Annotated, Any

import typer

from gridpush_drake.bench.gym import run
from gridpush_drake.bench.table import Table
from gridpush_drake.cli.bench.common import run_as_bench


@run_as_bench
def gym(
    games: Annotated[
        list[str] | None,
        typer.Option(
            "--game", metavar="NAME", help="A game; may be repeated.", show_default="all three"
        ),
    ] = None,
    episodes: Annotated[
        int, typer.Option(min=2, help="Episodes of each game that each player plays.")
    ] = 20,
    **common: Any,
) -> list[Table]:
    """Time the Gymnasium environments; let our planner, a small learned player and chance play them."""
    return run(games, episodes, **common)
