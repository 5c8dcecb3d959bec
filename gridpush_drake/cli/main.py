"""The `gridpush` command, and how it ends.

On SIGINT, SIGTERM and SIGHUP it ends at once, all it started with it, and with an exit code that
says so; see `interrupts`.
"""

import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated, Any

import typer

from gridpush_drake.cli import (
    bench,
    calibrate,
    campaign,
    demo,
    export,
    identify,
    import_logs,
    plan,
    predict,
    record,
    robot,
    show,
    simulate,
    slide,
    track,
    tracker,
    twin,
    view,
)
from gridpush_drake.cli import object as object_from_photo
from gridpush_drake.cli.interrupts import (
    EXIT_INTERRUPTED,
    SIGNAL_CODES,
    say_interrupted,
    watch_interrupts,
)
from gridpush_drake.errors import GridPushError, ObjectWarning, PushLogWarning

EXIT_BAD_INPUT = 2

DOUBTS = (ObjectWarning, PushLogWarning)
"""Warnings that are for the user."""

GRACEFUL = {"demo", "view", "twin", "tracker", "robot"}
"""Commands that answer an interrupt themselves: they end in order, and write what was done."""

app = typer.Typer(
    name="gridpush",
    help="Learn an object's friction and mass by pushing it, and predict where the next push takes it.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["--help", "-h"]},
)

COMMANDS: dict[str, Callable[..., None]] = {
    "demo": demo.demo, "campaign": campaign.campaign, "identify": identify.identify, "predict": predict.predict,
    "simulate": simulate.simulate, "show": show.show, "plan": plan.plan, "export": export.export, "view": view.view,
    "slide": slide.slide, "object": object_from_photo.make_object, "calibrate": calibrate.calibrate,
    "track": track.track, "record": record.record, "twin": twin.twin, "tracker": tracker.tracker, "robot": robot.robot,
}  # fmt: skip
for name, command in COMMANDS.items():
    app.command(name)(command)
app.add_typer(import_logs.app, name="import")
app.add_typer(bench.app, name="bench")


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
    sys.exit(code)


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
