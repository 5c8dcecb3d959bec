"""The `gridpush` command: the table of its commands, and how a command ends.

This module turns what goes wrong in a command into one line on standard error and an exit code. The
commands themselves are in the other modules of this package, one in each. Signals are handled in
`interrupts`, and a standard output that cannot be written to in `output`.
"""

import re
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any

import typer

from gridpush_drake.cli.shell.interrupts import (
    EXIT_INTERRUPTED,
    SIGNAL_CODES,
    say_interrupted,
    watch_interrupts,
)
from gridpush_drake.cli.shell.lazy_group import LazyCommand, LazyGroup
from gridpush_drake.cli.shell.output import safe_output
from gridpush_drake.cli.shell.ros_args import ROS_ARGUMENTS, split_ros_arguments
from gridpush_drake.errors import GridPushError, ObjectWarning, PushLogWarning

EXIT_BAD_INPUT = 2
"""Exit code after bad input: an option, a file or a field that is not as expected."""

USER_FILE_WARNINGS = (ObjectWarning, PushLogWarning)
"""Warnings about the user's own files. They are printed in one line; all others are left alone."""

PLAIN_WORDS = {
    r"Value error, ": "",
    r"Input should be a valid integer\b.*": "expected a whole number",
    r"Input should be a valid number\b.*": "expected a number",
    r"Input should be greater than or equal to (\S+)": r"expected at least \1",
    r"Input should be less than or equal to (\S+)": r"expected at most \1",
}
"""Patterns of Pydantic's messages about options, by which Typer checks their values, and what is
said instead."""

RENAMED_OPTIONS = {"--nothing-told": "--unknown-inertia"}
"""Options by their old names, which are taken with a warning for one more release."""

LINK_COMMANDS = {"twin", "tracker", "robot"}
"""Commands that take arguments of ROS."""

GRACEFUL_COMMANDS = {"demo", "view", "twin", "tracker", "robot"}
"""Commands that handle Ctrl-C themselves: they finish in order, and write what was done so far."""

COMMANDS: dict[str, LazyCommand] = {
    "demo": LazyCommand(
        "gridpush_drake.cli.run.demo:demo",
        "Let a simulated robot learn an object by poking it, and then push or lift it.",
    ),
    "campaign": LazyCommand(
        "gridpush_drake.cli.run.campaign:campaign",
        "Run the demo many times, with many seeds and objects, and count how the runs ended.",
    ),
    "identify": LazyCommand(
        "gridpush_drake.cli.learn.identify:identify",
        "Learn from a log of pushes where an object is heavy and where it rubs.",
    ),
    "predict": LazyCommand(
        "gridpush_drake.cli.learn.predict:predict",
        "Predict where pushes take an object, and compare with where they really took it.",
    ),
    "simulate": LazyCommand(
        "gridpush_drake.cli.learn.simulate:simulate",
        "Simulate one push of an object or of a learned model.",
    ),
    "show": LazyCommand(
        "gridpush_drake.cli.view.show:show",
        "Draw a picture of an object, or of a learned model.",
    ),
    "plan": LazyCommand(
        "gridpush_drake.cli.run.plan:plan",
        "Plan pushes that bring an object to a goal pose.",
    ),
    "slide": LazyCommand(
        "gridpush_drake.cli.run.slide:slide",
        "Plan pushes that bring an object to the table's edge, so that it can be grasped there.",
    ),
    "export": LazyCommand(
        "gridpush_drake.cli.view.export:export",
        "Write an object or a learned model as a file for Drake (SDFormat, URDF) or MuJoCo (MJCF).",
    ),
    "view": LazyCommand(
        "gridpush_drake.cli.view.view:view",
        "Show a learned model, a log of pushes or a recording in the browser, or in Rerun.",
    ),
    "object": LazyCommand(
        "gridpush_drake.cli.camera.object:make_object",
        "Find the object in a photograph, and write an object file for it.",
    ),
    "calibrate": LazyCommand(
        "gridpush_drake.cli.camera.calibrate:calibrate",
        "Find where a camera is, and what camera it is, from photographs of a printed board.",
    ),
    "track": LazyCommand(
        "gridpush_drake.cli.camera.track:track",
        "Follow an object through a video, and write the pushes in it as a push log.",
    ),
    "record": LazyCommand(
        "gridpush_drake.cli.learn.record:record",
        "Cut a long recording of poses into pushes, and write them as a push log.",
    ),
    "twin": LazyCommand(
        "gridpush_drake.cli.run.twin:twin",
        "Simulate a robot that `gridpush robot` can move as if it were a real one.",
    ),
    "tracker": LazyCommand(
        "gridpush_drake.cli.run.tracker:tracker",
        "Find an object in a camera's pictures, and tell `gridpush robot` where it is.",
    ),
    "robot": LazyCommand(
        "gridpush_drake.cli.run.robot:robot",
        "Carry out a task of `gridpush demo` with a real arm. Nothing moves without --go.",
    ),
    "warm-up": LazyCommand(
        "gridpush_drake.cli.shell.warm_up:warm_up",
        "Compile the simulation to machine code now, so that no later command has to wait for it.",
    ),
    "import": LazyCommand(
        "gridpush_drake.cli.learn.import_logs:app",
        "Convert a public data set or a ROS bag to a push log and an object file.",
    ),
    "bench": LazyCommand(
        "gridpush_drake.cli.bench.group:app",
        "Measure speed and accuracy, on the objects that ship with the package.",
    ),
}
"""All commands, in the order in which `gridpush --help` lists them."""


MAIN_HELP = (
    "Learn where an object is heavy and where it rubs by pushing it, and predict where the next "
    "push takes it."
)
"""What `gridpush --help` says first."""


class GridPushGroup(LazyGroup):
    """The group of all commands of `gridpush`."""

    lazy_commands = COMMANDS


app = typer.Typer(
    name="gridpush",
    cls=GridPushGroup,
    help=MAIN_HELP,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["--help", "-h"]},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from gridpush_drake import __version__

        print(f"gridpush {__version__}")
        raise typer.Exit


@app.callback()
def common(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    """Takes the options of `gridpush` itself; its help is that of `app`."""


def main(args: list[str] | None = None) -> None:
    """Runs the command line and exits.

    The exit code is 0 if the command did what it was asked to; 1 if there is no plan, or the robot
    did not reach its goal; 2 after bad input, which is explained in one line; 3 if a model was
    learned that explains little of its own pushes; and 129, 130 or 143 if a signal ended it.

    Args:
        args: the words after `gridpush`. None for those of this process, which then ends with the
            command. If words are given, the process is assumed to go on afterwards.
    """
    with safe_output() as output:
        code = _run_watched(args)
        # Output that is still kept back may be refused only now, and the exit code has to tell
        output.flush()
        if output.problem:
            lost = f"standard output {output.problem}; what was printed there is lost"
            code = code or _fail(lost)
    sys.exit(code)


def _run_watched(args: list[str] | None) -> int | None:
    """Runs the command line with its signals handled; returns the exit code, or None for 0."""
    first_word = sys.argv[1:2] if args is None else args[:1]
    graceful = not GRACEFUL_COMMANDS.isdisjoint(first_word)
    with watch_interrupts(last=args is None, graceful=graceful) as interrupts:
        try:
            code = _run(args)
            interrupts.finish()
        except KeyboardInterrupt:
            code = EXIT_INTERRUPTED
    # Commands such as `twin` run until Ctrl-C: after it they have done what was asked, and return
    # 0. After any other signal the exit code always names it.
    ended_by_other_signal = interrupts.code in SIGNAL_CODES - {EXIT_INTERRUPTED}
    if code in SIGNAL_CODES or ended_by_other_signal:
        code = interrupts.code or code
        say_interrupted()
    return code


def _run(args: list[str] | None) -> int | None:
    """Runs the command line; returns the exit code, or None for 0."""
    try:
        own, ros = split_ros_arguments(sys.argv[1:] if args is None else args)
        if ros and LINK_COMMANDS.isdisjoint(own[:1]):
            return _fail(
                f"--ros-args: expected one of {', '.join(sorted(LINK_COMMANDS))}, with --ros2"
            )
        ROS_ARGUMENTS.set(ros)
        own = _rename_options(own)
        with _short_warnings():
            code: int | None = app(args=own, prog_name="gridpush", standalone_mode=False)
    except GridPushError as error:
        code = _fail(str(error))
    except typer.TyperException as error:
        # A bare `gridpush` has printed its help, as was asked, and has no message
        message = _say_plainly(error.format_message())
        code = _fail(message) if message.strip() else None
    except MemoryError:
        code = _fail("out of memory; expected a smaller object, push log or image")
    return code


def _rename_options(words: list[str]) -> list[str]:
    """Replaces old names of options by what they are called now, and warns of each."""
    for old in RENAMED_OPTIONS.keys() & set(words):
        print(f"gridpush: warning: {old} is called {RENAMED_OPTIONS[old]} now", file=sys.stderr)
    return [RENAMED_OPTIONS.get(word, word) for word in words]


def _say_plainly(message: str) -> str:
    """Says in this project's words what Pydantic says of the value of an option."""
    for pattern, words in PLAIN_WORDS.items():
        message = re.sub(pattern, words, message)
    return message


@contextmanager
def _short_warnings() -> Iterator[None]:
    """Prints each warning about an object or a push log once, as one line on standard error.

    It does so whatever filters for warnings the process has.
    """
    with warnings.catch_warnings():
        for warning in USER_FILE_WARNINGS:
            warnings.simplefilter("always", warning)
        show = warnings.showwarning
        printed = set[str]()

        def print_short(
            message: Warning | str,
            category: type[Warning],
            filename: str,
            lineno: int,
            file: Any = None,
            line: str | None = None,
        ) -> None:
            if not issubclass(category, USER_FILE_WARNINGS):
                show(message, category, filename, lineno, file, line)
            elif str(message) not in printed:
                printed.add(str(message))
                print(f"gridpush: warning: {' '.join(str(message).split())}", file=sys.stderr)

        warnings.showwarning = print_short
        yield


def _fail(message: str) -> int:
    """Prints an error as one line; returns the exit code that goes with it."""
    print(f"gridpush: error: {' '.join(message.split())}", file=sys.stderr)
    return EXIT_BAD_INPUT


if __name__ == "__main__":
    main()
