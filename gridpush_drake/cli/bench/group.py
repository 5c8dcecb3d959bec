"""`gridpush bench`: the measurements, as tables. What one of them needs is imported when it runs.

Each target below is a `bench.study.Study`; `cli.bench.command` makes a command of it.
"""

from importlib import import_module
from typing import Any

import typer

from gridpush_drake.cli.shell.lazy_group import LazyCommand, LazyGroup, make_single

BENCHES: dict[str, LazyCommand] = {
    "speed": LazyCommand(
        "gridpush_drake.bench.speed:STUDY",
        "Time a push and its gradient, the same push in MuJoCo, pushes of ever more cells, "
        "identifications, decisions and start-up.",
    ),
    "paper": LazyCommand(
        "gridpush_drake.bench.paper_figures:STUDY",
        "Repeat the paper's simulated identification, every method beside the others.",
    ),
    "real": LazyCommand(
        "gridpush_drake.bench.real:STUDY",
        "Learn from real robots' pushes (--data), or simulated ones in their place, and "
        "predict others of them.",
    ),
    "reality": LazyCommand(
        "gridpush_drake.bench.reality.experiments:STUDY",
        "Predict every set of real pushes (--data), or simulated ones in their place, by our "
        "model and by Drake's and MuJoCo's plants with the same masses.",
    ),
    "planning": LazyCommand(
        "gridpush_drake.bench.planning:STUDY",
        "Choose contact points, and push objects to goal poses on the paper's round table.",
    ),
    "stable": LazyCommand(
        "gridpush_drake.bench.stable_paths:STUDY",
        "Push bodies that do not obey the model to goals 0.3 m away, unseen: by stable pushes of "
        "two fingertips, and by pushes of one finger.",
    ),
    "pregrasp": LazyCommand(
        "gridpush_drake.bench.pregrasp.experiments:STUDY",
        "Slide objects of hidden masses to the table's edge, and compare pokes by design with "
        "random ones.",
    ),
    "grasp": LazyCommand(
        "gridpush_drake.bench.grasp:STUDY",
        "Let the whole station poke objects, slide them to the table's edge, grasp and lift them.",
    ),
    "weighing": LazyCommand(
        "gridpush_drake.bench.tilt_tests.experiments:STUDY",
        "Find mass, center of mass and friction of objects of which nothing is told, by pushes "
        "and presses at the table's edge.",
    ),
    "truth": LazyCommand(
        "gridpush_drake.bench.truth.learning:STUDY",
        "Learn bodies that do not obey the model: MuJoCo pushes them, on feet, foundations "
        "and uneven bottoms.",
    ),
    "hypotheses": LazyCommand(
        "gridpush_drake.bench.truth.hypotheses:STUDY",
        "Learn bodies of many kinds with all load hypotheses and without each of them, to see "
        "which ones pay.",
    ),
    "feedback": LazyCommand(
        "gridpush_drake.bench.steering.experiments:STUDY",
        "Push learned objects with feedback, along paths, to goals and back after shoves: in the "
        "LCP world, and bodies in MuJoCo.",
    ),
    "drake": LazyCommand(
        "gridpush_drake.bench.drake:STUDY",
        "Compare Drake's plant and MuJoCo with the grid LCP, time the LCP system, and let the "
        "whole station learn.",
    ),
    "scene": LazyCommand(
        "gridpush_drake.bench.multi_object.experiments:STUDY",
        "Compare the model of objects that push each other with Drake's plant and MuJoCo, learn "
        "such objects together, and time their pushes.",
    ),
    "scene-tasks": LazyCommand(
        "gridpush_drake.bench.multi_object.scene_tasks:STUDY",
        "Rearrange and separate several objects, and fetch one of them, in the plain world: "
        "success, simulated time, pushes.",
    ),
    "perception": LazyCommand(
        "gridpush_drake.bench.perception.experiments:STUDY",
        "Find objects in photographs, real and rendered, and track them while they are pushed.",
    ),
    "gym": LazyCommand(
        "gridpush_drake.bench.games.environments:STUDY",
        "Time the Gymnasium environments; let our planner, a small learned player and chance "
        "play them.",
    ),
    "pusht": LazyCommand(
        "gridpush_drake.bench.pusht.experiments:STUDY",
        "Play PushT of gym-pusht with feedback, learning the T's friction within each episode.",
    ),
    "release": LazyCommand(
        "gridpush_drake.bench.release:STUDY",
        "Measure what the pages state, over several sittings, and write their tables.",
    ),
}
"""All benches, in the order in which the help lists them."""


class BenchGroup(LazyGroup):
    """The commands of `gridpush bench`."""

    lazy_commands = BENCHES

    def load(self, name: str, target: str) -> Any:
        """Imports a study, and makes a command of it."""
        # what makes commands stands on the benches' tables and jobs, which the list does not need
        command = import_module("gridpush_drake.cli.bench.command")
        module, _, attribute = target.partition(":")
        study = getattr(import_module(module), attribute)
        return make_single(name, command.make_command(study))


app = typer.Typer(
    cls=BenchGroup,
    no_args_is_help=True,
    help="Measure speed and accuracy, on the objects that ship with the package.",
)
