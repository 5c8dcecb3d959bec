"""A group of commands, each of which is imported when it is asked for: Click's LazyGroup.

The list of commands, in `--help` and in the shell's completion, needs only names and one line of
help each. These stand in a table, so that the list is shown without importing any command. A
command that runs, or whose own help is shown, is imported as a whole; its module can therefore have
its imports at its top, however long they take.
"""

import gc
import inspect
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from copy import copy
from difflib import get_close_matches
from inspect import Parameter, Signature
from pkgutil import resolve_name
from typing import Any, ClassVar, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup

from gridpush_drake.errors import GridPushError


class LazyCommand(NamedTuple):
    """Where a command is, and what the list of commands says about it.

    Attributes:
        target: "MODULE:NAME" of a function, or of a `typer.Typer` that has commands of its own.
        help: the first paragraph of the command's own help; a test compares the two.
    """

    target: str
    help: str


class ListedCommand(TyperCommand):
    """A command that is not imported yet: it can be listed, but not run."""


class LazyGroup(TyperGroup):
    """A group whose commands are imported when they are asked for.

    A subclass gives the table; `typer.Typer(cls=...)` takes that subclass.

    Attributes:
        lazy_commands: the commands by their names, in the order in which they are listed.
    """

    lazy_commands: ClassVar[Mapping[str, LazyCommand]] = {}

    def __init__(self, **settings: Any) -> None:
        """Lists the commands of the table; none of them is imported.

        Args:
            settings: the arguments of `TyperGroup`, which Typer passes.
        """
        super().__init__(**settings)
        self._settings = settings
        for name, command in self.lazy_commands.items():
            self.commands[name] = ListedCommand(name, help=command.help)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Imports a command, and returns it; returns None if there is no command of this name."""
        command = self.commands.get(cmd_name)
        if isinstance(command, ListedCommand):
            command = self.load(cmd_name, self.lazy_commands[cmd_name].target)
            self.commands[cmd_name] = command
        return command

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Finds the command that the words name.

        Raises:
            GridPushError: there is no such command; the message names those that there are.
        """
        refuse_unknown(ctx.command_path, args[:1], self.list_commands(ctx))
        return super().resolve_command(ctx, args)

    def load(self, name: str, target: str) -> Any:
        """Imports the command of a name; a subclass may make it of other things than functions."""
        return load_command(name, target)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Writes the group's help, with the list of its commands."""
        self._make_listing().format_help(ctx, formatter)

    def shell_complete(self, ctx: Any, incomplete: str) -> Any:
        """Returns the commands and options that begin with what was typed."""
        listing = self._make_listing()
        # the commands that are completed are those of the context's own group
        context = copy(ctx)
        context.command = listing
        return listing.shell_complete(context, incomplete)

    def _make_listing(self) -> TyperGroup:
        """Makes a group with the same help and options that imports no command to list it."""
        return TyperGroup(
            **{**self._settings, "commands": dict(self.commands), "params": self.params}
        )


def refuse_unknown(path: str, first: list[str], known: list[str]) -> None:
    """Refuses the name of a command that is not there.

    Args:
        path: the words before it, such as "gridpush bench".
        first: the word that should name a command, in a list; options are left to Typer.
        known: names of the commands.

    Raises:
        GridPushError: there is no such command.
    """
    for name in first:
        if name not in known and not name.startswith("-"):
            near = get_close_matches(name, known, n=1)
            guess = f"; did you mean {near[0]}?" if near else ";"
            raise GridPushError(
                f"{path} {name}: there is no such command{guess} expected one of {', '.join(known)}"
            )


def load_command(name: str, target: str) -> Any:
    """Imports a command.

    Args:
        name: the command's name on the command line.
        target: see `LazyCommand`.

    Returns:
        The command or group, as Typer runs it.
    """
    with without_garbage_collection():
        found = resolve_name(target)
    if isinstance(found, typer.Typer):
        command: Any = typer.main.get_group(found)
    else:
        command = make_single(name, found)
    command.name = name
    return command


@contextmanager
def without_garbage_collection() -> Iterator[None]:
    """Keeps Python from looking for garbage while modules are imported, which leave next to none.

    It would look through all that was imported again and again: a fifth of the time of an import.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def declare(function: Any, options: Mapping[str, tuple[Any, Any]], help_text: str) -> Any:
    """Declares the options of a function that takes any, as Typer reads them from its signature.

    Args:
        function: is called with all options by name.
        options: the annotation and the default of each; `Parameter.empty` where it must be given.
        help_text: the command's help.

    Returns:
        The function.
    """
    parameters = [
        Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
        for name, (annotation, default) in options.items()
    ]
    function.__signature__ = Signature(parameters)
    function.__annotations__ = {each.name: each.annotation for each in parameters}
    function.__doc__ = help_text
    return function


def make_single(name: str, function: Any) -> Any:
    """Makes a command of a function, whose docstring is the command's help."""
    # an application of one command that has no group is that command
    single = typer.Typer(add_completion=False)
    single.command(name, help=join_lines(function.__doc__ or ""))(function)
    command: Any = typer.main.get_command(single)
    command.name = name
    return command


def join_lines(docstring: str) -> str:
    """Returns a docstring whose paragraphs are one line each.

    Typer would keep the line breaks of the source, whatever the width of the terminal is.
    """
    paragraphs = inspect.cleandoc(docstring).split("\n\n")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)
