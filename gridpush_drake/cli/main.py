"""The `gridpush` command, and how it ends.

On SIGINT, SIGTERM and SIGHUP it ends at once, all it started with it, and with an exit code that
says so; see `interrupts`.
"""

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any

import typer

from gridpush_drake.cli.interrupts import (
    EXIT_INTERRUPTED,
    SIGNAL_CODES,
    say_interrupted,
    watch_interrupts,
)
from gridpush_drake.cli.lazy_group import LazyCommand, LazyGroup
from gridpush_drake.cli.output import safe_output
from gridpush_drake.errors import GridPushError, ObjectWarning, PushLogWarning

EXIT_BAD_INPUT = 2

DOUBTS = (ObjectWarning, PushLogWarning)
"""Warnings that are for the user."""

GRACEFUL = {"demo", "view", "twin", "tracker", "robot"}
"""Commands that answer an interrupt themselves: they end in order, and write what was done."""

COMMANDS: dict[str, LazyCommand] = {
    "demo": LazyCommand(
        "gridpush_drake.cli.demo:demo",
        "Let a simulated robot poke an object to learn it, then push or lift it; write a "
        "report and a recording.",
    ),
    "campaign": LazyCommand(
        "gridpush_drake.cli.campaign:campaign",
        "Run whole episodes with many seeds and objects: how many are held, dropped, given "
        "up, and why.",
    ),
    "identify": LazyCommand(
        "gridpush_drake.cli.identify:identify",
        "Learn an object's friction and mass from pushes of it.",
    ),
    "predict": LazyCommand(
        "gridpush_drake.cli.predict:predict",
        "Predict where pushes take an object, and compare with where they took it.",
    ),
    "simulate": LazyCommand(
        "gridpush_drake.cli.simulate:simulate",
        "Simulate one push of an object or of a learned model.",
    ),
    "show": LazyCommand(
        "gridpush_drake.cli.show:show",
        "Draw an object with its parts, or what a model learned of it.",
    ),
    "plan": LazyCommand(
        "gridpush_drake.cli.plan:plan",
        "Plan pushes that bring an object, or a learned model, to a goal pose.",
    ),
    "export": LazyCommand(
        "gridpush_drake.cli.export:export",
        "Write an object or a learned model for Drake (SDFormat, URDF) or MuJoCo (MJCF).",
    ),
    "view": LazyCommand(
        "gridpush_drake.cli.view:view",
        "Show a learned model, replay pushes beside their predictions, or play a recording, "
        "in Meshcat.",
    ),
    "slide": LazyCommand(
        "gridpush_drake.cli.slide:slide",
        "Plan pushes to the table's edge, until a part hangs over that a gripper can take and "
        "nothing falls.",
    ),
    "object": LazyCommand(
        "gridpush_drake.cli.object:make_object",
        "Find the object in a photograph and write its outline, cells and height as an object "
        "file.",
    ),
    "calibrate": LazyCommand(
        "gridpush_drake.cli.calibrate:calibrate",
        "Find the camera's pose from a photograph of a board of tags: its middle is the "
        "world's origin, z up.",
    ),
    "track": LazyCommand(
        "gridpush_drake.cli.track:track",
        "Follow an object through a video and write the pushes in it as a push log.",
    ),
    "record": LazyCommand(
        "gridpush_drake.cli.record:record",
        "Cut a stream of the tip's and the object's poses into pushes, as the robot does "
        "while it pokes.",
    ),
    "twin": LazyCommand(
        "gridpush_drake.cli.twin:twin",
        "Simulate a robot that speaks its driver's LCM messages, for `gridpush robot` to "
        "move; Ctrl-C ends it.",
    ),
    "tracker": LazyCommand(
        "gridpush_drake.cli.tracker:tracker",
        "Find an object in a camera's LCM pictures and tell `gridpush robot` where it is; "
        "Ctrl-C ends it.",
    ),
    "robot": LazyCommand(
        "gridpush_drake.cli.robot:robot",
        "Carry out a task of `gridpush demo` with a real arm over LCM; nothing moves before --go.",
    ),
    "warm-up": LazyCommand(
        "gridpush_drake.cli.warm_up:warm_up",
        "Compile the kernels now, so that no later command has to; once a machine and version.",
    ),
    "import": LazyCommand(
        "gridpush_drake.cli.import_logs:app",
        "Convert a public data set or a ROS bag to a push log and an object file.",
    ),
    "bench": LazyCommand(
        "gridpush_drake.cli.bench.group:app",
        "Measure speed and accuracy, on the objects that ship with the package.",
    ),
}
"""All commands, in the order in which the help lists them."""


class GridPushGroup(LazyGroup):
    """The commands of `gridpush`."""

    lazy_commands = COMMANDS


app = typer.Typer(
    name="gridpush",
    cls=GridPushGroup,
    help="Learn an object's friction and mass by pushing it, and predict where the next push takes it.",
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
    """Learn an object's friction and mass by pushing it, and predict where the next push takes it."""


def main(args: list[str] | None = None) -> None:
    """Runs the command line and exits.

    0: done; 1: no plan found; 2: bad input (said in one line); 3: a learned model explains little;
    129, 130 or 143: ended by a signal.

    Args:
        args: instead of the process's own; the process is then taken to go on after the command.
    """
    with safe_output() as output:
        code = _run_watched(args)
        output.flush()
        if output.problem:
            code = code or _fail(f"standard output {output.problem}; what was to be said is lost")
    sys.exit(code)


def _run_watched(args: list[str] | None) -> int | None:
    """Runs the command line, with signals handled; returns the exit code, None for 0."""
    graceful = not GRACEFUL.isdisjoint(sys.argv[1:2] if args is None else args[:1])
    with watch_interrupts(last=args is None, graceful=graceful) as interrupts:
        try:
            code = _run(args)
            interrupts.finish()
        except KeyboardInterrupt:
            code = EXIT_INTERRUPTED
    # a command that is to be ended by Ctrl-C alone, as the twin is, has done its work then
    ended = interrupts.code in SIGNAL_CODES - {EXIT_INTERRUPTED}
    if code in SIGNAL_CODES or ended:
        code = interrupts.code or code
        say_interrupted()
    return code


def _run(args: list[str] | None) -> int | None:
    """Runs the command line; returns the exit code, None for 0."""
    try:
        with _short_warnings():
            code: int | None = app(args=args, prog_name="gridpush", standalone_mode=False)
    except GridPushError as error:
        code = _fail(str(error))
    except typer.TyperException as error:
        code = _fail(error.format_message()) if error.format_message().strip() else error.exit_code
    except MemoryError:
        code = _fail("out of memory; expected a smaller object, log or image")
    return code


@contextmanager
def _short_warnings() -> Iterator[None]:
    """Prints each warning about a mask or a push log as one line on standard error, whatever filters are set."""
    with warnings.catch_warnings():
        for doubt in DOUBTS:
            warnings.simplefilter("always", doubt)
        show, told = warnings.showwarning, set[str]()

        def print_short(
            message: Warning | str, category: type[Warning], filename: str, lineno: int, file: Any = None,
            line: str | None = None,
        ) -> None:  # fmt: skip
            if not issubclass(category, DOUBTS):
                show(message, category, filename, lineno, file, line)
            elif str(message) not in told:
                told.add(str(message))
                print(f"gridpush: warning: {' '.join(str(message).split())}", file=sys.stderr)

        warnings.showwarning = print_short
        yield


def _fail(message: str) -> int:
    print(f"gridpush: error: {' '.join(message.split())}", file=sys.stderr)
    return EXIT_BAD_INPUT


if __name__ == "__main__":
    main()
