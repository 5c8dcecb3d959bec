"""What several commands share: options, tables, the objects, models and logs they read, and compiled kernels."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer

from gridpush_drake.bench.cluster import open_cluster
from gridpush_drake.bench.jobs import Execution, Results
from gridpush_drake.cli.console import count_noun, print_notice, work_progress
from gridpush_drake.cli.kernels import compile_all
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.errors import MAX_NUMBER, GridPushError, PlanningError
from gridpush_drake.files import check_writable, exists, is_file, is_same
from gridpush_drake.identification.model_file import looks_like_model, read_model
from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.pushes.push_log import DEFAULT_PUSHER_RADIUS, PushLog

ObjectOrModel = Annotated[
    str,
    typer.Argument(
        metavar="OBJECT_OR_MODEL",
        help="An object file, a model that `gridpush identify` wrote, or the name of a shipped object.",
        show_default=False,
    ),
]

PushesFile = Annotated[
    Path,
    typer.Argument(
        metavar="PUSHES.csv",
        help="A push log, a CSV file with the columns push, t, tip_x, tip_y, object_x, object_y, object_theta and, if"
        " known, force_x, force_y, overhang and table.",
        show_default=False,
    ),
]


def expect_ending(*endings: str) -> Callable[[Path | None], Path | None]:
    """Makes the callback of an option that refuses a file to be written whose name has none of the endings."""

    def check(path: Path | None) -> Path | None:
        if (
            path is not None
            and path.suffix.lower() not in endings
            and (is_file(path) or not exists(path))
        ):
            raise typer.BadParameter(
                f"is {str(path)!r}; expected a name that ends with {endings[0]}"
            )
        return path

    return check


PNG, HTML = expect_ending(".png"), expect_ending(".html", ".htm")

Force = Annotated[bool, typer.Option("--force", help="Replace output files that exist.")]

Json = Annotated[
    bool,
    typer.Option("--json", help="Print one JSON document on standard output, and nothing else."),
]

LargestPiece = Annotated[
    bool, typer.Option("--largest-piece", help="Of a mask in several pieces, keep the largest.")
]

Regime = Annotated[
    Literal["auto", "quasi_static", "inertial"],
    typer.Option(
        help="quasi_static for slow pushes, inertial for fast ones; auto: by their speed."
    ),
]

Height = Annotated[
    float | None,
    typer.Option(help="Height of the object, m.", show_default="as its file says, or 0.03"),
]

Seed = Annotated[int, typer.Option(min=0, help="Seed of everything random.")]

Workers = Annotated[int, typer.Option(min=1, help="Processes.")]

Dask = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS", help="Use the workers of the Dask cluster whose scheduler is there, such as tcp://host:8786,"
        " instead of processes here (pip install '.\\[cluster]'; workers of one thread each are best).",
    ),
]  # fmt: skip

WORKERS = 2
"""Processes by default."""


DEFAULT_HEIGHT = 0.03
"""Of an object whose file does not say it, m."""

EXIT_NO_PLAN = 1
"""Exit code where the arguments are in order but there is no way to do it."""


class OptionError(GridPushError):
    """An option's value is not of its form."""


def parse_numbers(option: str, text: str, names: str) -> tuple[float, ...]:
    """Reads as many numbers, at most MAX_NUMBER, separated by commas, as `names` has, such as "x,y".

    Raises:
        OptionError: the text is something else.
    """
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != len(names.split(",")) or not all(
        abs(number) <= MAX_NUMBER for number in numbers
    ):
        raise OptionError(
            f"{option}: is {text!r}; expected {names}, such as {','.join(['0.1'] * len(names.split(',')))}"
        )
    return numbers


FORMS = "rectangle:WxH@x,y, round:R@x,y, both also without @x,y, or polygon:x,y;x,y;x,y (m)"

Table = Annotated[
    str,
    typer.Option("--table", metavar="SHAPE", help=f"The table's top: {FORMS}.", show_default=False),
]


def parse_shape(option: str, text: str) -> SupportSurface:
    """Reads a table, or an obstacle.

    Args:
        option: its name, for the message.
        text: `rectangle:0.8x0.6@0,0` (sides along x and y, then the center), `round:0.5@0.6,0`
            (radius, then the center) or `polygon:0,0;1,0;0,1` (corners), m; a center left out is
            the world's origin.

    Returns:
        The table.

    Raises:
        OptionError: the text is of no such form.
        PlanningError: a side or radius is not positive, or the polygon crosses itself.
    """

    def read(numbers: str, separator: str, count: int) -> list[float]:
        parts = numbers.split(separator)
        if len(parts) != count:
            raise ValueError
        return [float(part) for part in parts]

    kind, _, rest = text.partition(":")
    size, _, center = rest.partition("@")
    try:
        at = read(center, ",", 2) if center else [0.0, 0.0]
        if kind == "rectangle":
            return SupportSurface.rectangle(at, read(size, "x", 2))
        if kind == "round":
            return SupportSurface.round(at, read(size, "x", 1)[0])
        if kind == "polygon" and not center:
            return SupportSurface.from_polygon([read(corner, ",", 2) for corner in rest.split(";")])
    except ValueError:
        pass
    except PlanningError as error:
        raise PlanningError(f"{option}: {str(error).removeprefix('table: ')}") from error
    raise OptionError(f"{option}: is {text!r}; expected {FORMS}")


@dataclass(frozen=True, eq=False)
class Target:
    """What a command works on: an object, what it is taken to weigh and rub (the model's, or uniform by its prior)."""

    obj: GridObject
    params: CellParameters
    model: Identification | None = None

    def make_physics(self, regime: Regime) -> Physics:
        """The model's physics, or else the default one; with `regime`, unless that is "auto"."""
        physics = self.model.physics if self.model else Physics()
        return physics if regime == "auto" else physics.with_regime(regime)


@contextmanager
def executing(
    what: str, workers: int, dask: str | None, open_results: Callable[[], Results]
) -> Iterator[Execution]:
    """How jobs are run: their results are kept, and what is done is shown.

    Args:
        what: they are of, in a word.
        workers: processes here.
        dask: address of a cluster that runs them instead; None for none.
        open_results: where they are kept; called once the cluster has answered.

    Raises:
        GridPushError: no cluster answers.
    """
    with ExitStack() as stack:
        executor = None
        if dask is not None:
            executor = stack.enter_context(open_cluster(dask))
        results = open_results()
        known = f", {len(results.lines)} of them from before" if results.lines else ""

        def prepare() -> None:
            print_notice(f"{what}: results are kept in {results.path}{known}")
            compile_kernels()

        yield Execution(
            workers, stack.enter_context(work_progress(what)), results, prepare, executor
        )


def check_outputs(
    force: bool, *paths: Path | None, inputs: Sequence[Path | str | None] = ()
) -> None:
    """Checks, before long work begins, that files may be written, each to its own place.

    Args:
        force: whether existing files may be replaced.
        paths: to be written; None for what is not asked for.
        inputs: files that are read, none of which may be replaced even so; None for what is not
            read.

    Raises:
        OutputError: one may not be written.
        OptionError: two are the same, or one is an input.
    """
    given = [path for path in paths if path is not None]
    for i, path in enumerate(given):
        if path.resolve() in [other.resolve() for other in given[:i]]:
            raise OptionError(
                f"{path}: is to be written twice; expected a file of its own for each output"
            )
        check_writable(path, force)
        if any(other is not None and is_same(path, other) for other in inputs):
            raise OptionError(f"{path}: is read, too; expected another file to be written")


def describe_written(*paths: Path | None) -> list[str]:
    """Says in a line which files were written, where any were."""
    written = " and ".join(str(path) for path in paths if path is not None)
    return [f"Wrote {written}."] if written else []


def load_object(name: str, largest_piece: bool = False) -> GridObject:
    """Reads an object by its file or by the name it is shipped under. Raises ObjectError where there is neither."""
    return GridObject.from_yaml(object_path(name), largest_piece=largest_piece)


def object_path(name: str) -> Path:
    """The file of an object; a file goes before a shipped object of the same name."""
    path = Path(name)
    return path if exists(path) or path.suffix else find_shipped_object(name)


def load_target(name: str, largest_piece: bool = False) -> Target:
    """Reads an object or a model. Raises ObjectError or IdentificationError where it is neither."""
    if looks_like_model(name):
        model = read_model(name)
        return Target(model.obj, model.params, model)
    obj = load_object(name, largest_piece)
    return Target(obj, CellParameters.uniform(obj))


def choose_height(given: float | None, obj: GridObject) -> float:
    """Height of an object, m: as given, or as its file says, or DEFAULT_HEIGHT."""
    return given if given is not None else obj.height or DEFAULT_HEIGHT


def load_log(path: Path, obj: GridObject, *, require_final: bool = True) -> PushLog:
    """Reads a push log, made with the pusher that the object's file names; says so where it names none."""
    log = PushLog.read_csv(path, require_final=require_final)
    if log.radius_given:
        return log
    if obj.prior.pusher_radius is None:
        print_notice(
            f"{obj.name}: no pusher.radius in its file; {DEFAULT_PUSHER_RADIUS:g} m is taken for the pusher's"
        )
        return log
    return log.with_radius(obj.prior.pusher_radius)


def describe_overhanging(names: Sequence[str]) -> str:
    """Says which pushes were left out, and why."""
    return f"left out {count_noun(len(names), 'push')}, as the object hung over the table's edge: {', '.join(names)}"


def compile_kernels() -> None:
    """Loads the kernels, or compiles them, which is said on standard error, before anything has to be in time."""
    compile_all()
