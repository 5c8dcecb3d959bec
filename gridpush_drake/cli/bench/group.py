"""`gridpush bench`: the measurements, as tables. What one of them needs is imported when it runs."""

import typer

from gridpush_drake.cli.lazy_group import LazyCommand, LazyGroup

BENCHES: dict[str, LazyCommand] = {
    "speed": LazyCommand(
        "gridpush_drake.cli.bench.speed:speed",
        "Time a push, its gradient, MuJoCo beside, the cost against the number of cells, "
        "identification and start-up.",
    ),
    "paper": LazyCommand(
        "gridpush_drake.cli.bench.paper:paper",
        "Repeat the paper's simulated identification, every method beside the others.",
    ),
    "real": LazyCommand(
        "gridpush_drake.cli.bench.real:real",
        "Learn from real robots' pushes (--data), or simulated ones in their place, and "
        "predict others of them.",
    ),
    "planning": LazyCommand(
        "gridpush_drake.cli.bench.planning:planning",
        "Choose contact points, and push objects to goal poses on the paper's round table.",
    ),
    "pregrasp": LazyCommand(
        "gridpush_drake.cli.bench.pregrasp:pregrasp",
        "Slide objects of hidden masses to the table's edge, and compare pokes by design with "
        "random ones.",
    ),
    "grasp": LazyCommand(
        "gridpush_drake.cli.bench.grasp:grasp",
        "Let the whole station poke objects, slide them to the table's edge, grasp and lift them.",
    ),
    "truth": LazyCommand(
        "gridpush_drake.cli.bench.truth:truth",
        "Learn bodies that do not obey the model: MuJoCo pushes them, on feet, foundations "
        "and uneven bottoms.",
    ),
    "drake": LazyCommand(
        "gridpush_drake.cli.bench.drake:drake",
        "Set Drake's plant beside the grid LCP, time the LCP system, and let the whole "
        "station learn.",
    ),
    "perception": LazyCommand(
        "gridpush_drake.cli.bench.perception:perception",
        "Find objects in photographs, real and rendered, and track them while they are pushed.",
    ),
    "gym": LazyCommand(
        "gridpush_drake.cli.bench.gym:gym",
        "Time the Gymnasium environments; let our planner, a small learned player and chance "
        "play them.",
    ),
}
"""All benches, in the order in which the help lists them."""


class BenchGroup(LazyGroup):
    """The commands of `gridpush bench`."""

    lazy_commands = BENCHES


app = typer.Typer(
    cls=BenchGroup,
    no_args_is_help=True,
    help="Measure speed and accuracy, on the objects that ship with the package.",
)
