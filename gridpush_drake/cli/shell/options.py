r"""What several commands share: common options, and how they read objects, models and push logs.

Each option is a type that a command uses in its signature, such as `force: Force = False`. In a
help text, `[` has to be written as `\\[`: Rich would take `[word]` for markup and leave it out.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import typer

from gridpush_drake.cli.shell.console import count_noun, print_notice, work_progress
from gridpush_drake.cli.shell.kernels import compile_all
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.pusher import (
    DEFAULT_PUSHER_RADIUS,
    Pusher,
    choose_pusher_radius,
    find_pusher_radius,
)
from gridpush_drake.errors import (
    MAX_NUMBER,
    GridPushError,
    PlanningError,
    PushLogError,
    require_positive,
)
from gridpush_drake.files import check_writable, exists, is_file, is_same
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.model_file import looks_like_model, read_model
from gridpush_drake.identification.result import Identification
from gridpush_drake.jobs.cluster import open_cluster
from gridpush_drake.jobs.results import Results
from gridpush_drake.jobs.run import Execution
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object, speak_name
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.pushes.plausibility import MAX_FIRST_ANGLE, MAX_TABLE
from gridpush_drake.pushes.push_csv import PUSHER_HELP, parse_pusher
from gridpush_drake.pushes.push_log import PushLog

ObjectOrModel = Annotated[
    str,
    typer.Argument(
        metavar="OBJECT_OR_MODEL",
        help="An object file, a model file that `gridpush identify` wrote, or the name of a "
        "shipped object, such as claw_hammer.",
        show_default=False,
    ),
]

PushesFile = Annotated[
    Path,
    typer.Argument(
        metavar="PUSHES.csv",
        help="A push log: a CSV file with the columns push, t, tip_x, tip_y, object_x, object_y, "
        "object_theta (s, m and rad) and, if known, force_x, force_y, force_z (N), overhang and "
        "table.",
        show_default=False,
    ),
]


def expect_ending(*endings: str) -> Callable[[Path | None], Path | None]:
    """Makes the callback of an option that names a file to be written: it checks the name's ending.

    A path that is there and is no file is let through: what is wrong with it is said later.

    Args:
        endings: the endings that are allowed, such as ".png".
    """

    def check(path: Path | None) -> Path | None:
        if path is None or path.suffix.lower() in endings:
            return path
        if exists(path) and not is_file(path):
            return path
        raise typer.BadParameter(f"is {str(path)!r}; expected a name that ends with {endings[0]}")

    return check


EXPECT_PNG = expect_ending(".png")
"""Callback of an option that names a picture to be written."""

EXPECT_HTML = expect_ending(".html", ".htm")
"""Callback of an option that names a page to be written."""

EXPECT_MCAP = expect_ending(".mcap")
"""Callback of an option that names a recording to be written."""

RobotScene = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|DIR",
        help="The robot: gantry, iiwa14, panda, ur5e or xarm6, or the folder that holds "
        "your own robot.yaml. Its scene (arm, finger and table) replaces the scenario's.",
        show_default="the scenario's, an iiwa14",
    ),
]
"""`--robot`, in commands that simulate; see `make_robot_directives`."""

PusherOption = Annotated[
    Literal["finger", "gripper", "fingertips"] | None,
    typer.Option(
        "--pusher",
        metavar="PUSHER",
        help="What the robot pushes with. finger: the round tip of a finger; gripper: its closed "
        "gripper, which then points down; fingertips: both fingers of the open one. The last two "
        "go with --robot.",
        show_default="the scenario's, finger",
    ),
]
"""`--pusher`, in commands that simulate; see `PushScenario.pusher`."""

Record = Annotated[
    Path | None,
    typer.Option(
        "--record",
        metavar="FILE.mcap",
        callback=EXPECT_MCAP,
        help="Write the run as an MCAP file with standard ROS 2 messages, for Foxglove, too.",
    ),
]

Rerun = Annotated[
    str | None,
    typer.Option(
        "--rerun",
        metavar="FILE.rrd|live",
        help="Show the run in the Rerun viewer while it goes on (live), or write a file for it.",
    ),
]

Force = Annotated[
    bool,
    typer.Option(
        "--force",
        help="Replace output files that exist. Without it, the command ends with an error.",
    ),
]

Json = Annotated[
    bool,
    typer.Option(
        "--json",
        help="Print the result as one JSON document on standard output, and nothing else there. "
        "Numbers are in SI units (m, rad, s, kg, N) unless a name or a unit beside them says "
        "otherwise.",
    ),
]

PusherRadius = Annotated[
    float | None,
    typer.Option(
        "--radius",
        metavar="M",
        help="Radius of the pusher, which is a disc, m.",
        show_default=f"what the object's file says, else {DEFAULT_PUSHER_RADIUS:g}",
    ),
]

PushingShape = Annotated[
    str | None,
    typer.Option(
        "--pusher",
        metavar="SHAPE",
        help=f"Shape of a pusher that is no disc: {PUSHER_HELP}",
        show_default="a disc of --radius",
    ),
]

LargestPiece = Annotated[
    bool,
    typer.Option(
        "--largest-piece",
        help="If the object's mask (the picture of its outline) is in several pieces, use the "
        "largest one. Without it such a mask is refused.",
    ),
]

Regime = Annotated[
    Literal["auto", "quasi_static", "inertial"],
    typer.Option(
        metavar="REGIME",
        help="How pushes are simulated: quasi_static without inertia, for slow pushes; inertial "
        "with it, for fast ones; auto decides by the speed of the pushes.",
    ),
]

Height = Annotated[
    float | None,
    typer.Option(
        metavar="M",
        help="Height of the object above the table, m.",
        show_default="what its file says, else 0.03",
    ),
]

Seed = Annotated[
    int,
    typer.Option(
        min=0,
        help="Seed of everything random. The same seed gives the same result on one computer.",
    ),
]

Workers = Annotated[int, typer.Option(min=1, help="How many processes work at the same time.")]

Dask = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Let a Dask cluster do the work instead of processes on this computer. ADDRESS is "
        "that of its scheduler, such as tcp://host:8786. Needs pip install '.\\[cluster]'; workers "
        "with one thread each are best.",
    ),
]

DEFAULT_WORKERS = 2
"""How many processes work at the same time unless `--workers` says otherwise."""

DEFAULT_HEIGHT = 0.03
"""Height of an object if neither the command line nor its file gives one, m."""

EXIT_NO_PLAN = 1
"""Exit code if the input is good, but no plan does what is asked for."""


class OptionError(GridPushError):
    """The value of an option is not of the expected form."""


def parse_numbers(option: str, text: str, names: str, unit: str) -> tuple[float, ...]:
    """Reads numbers that are separated by commas.

    Args:
        option: the option's name, for the error's message.
        text: what the user wrote, such as "0.2,0.1".
        names: what the numbers are, such as "x,y"; as many numbers are expected as there are names.
        unit: their units in SI, such as "m, rad", for the error's message.

    Raises:
        OptionError: the text is something else, a number is beyond MAX_NUMBER, or an angle `theta`
            is so many turns that it must be in degrees.
    """
    count = len(names.split(","))
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    # written so that a NaN is refused, too
    within = all(abs(number) <= MAX_NUMBER for number in numbers)
    if len(numbers) != count or not within:
        example = ",".join(["0.1"] * count)
        raise OptionError(f"{option}: is {text!r}; expected {names} ({unit}), such as {example}")
    for name, number in zip(names.split(","), numbers, strict=True):
        if name == "theta" and abs(number) > MAX_FIRST_ANGLE:
            raise OptionError(
                f"{option}: theta is {number:g}: in degrees? expected {names} ({unit})"
            )
    return numbers


SHAPE_FORMS = "rectangle:WxH@x,y, round:R@x,y, both also without @x,y, or polygon:x,y;x,y;x,y (m)"
"""The forms of a shape on the command line, for messages."""

SHAPE_HELP = (
    "rectangle:WxH@x,y (sides along x and y, then the center), round:R@x,y (radius, then the "
    "center) or polygon:x,y;x,y;x,y (corners), all in m. A center that is left out is 0,0."
)
"""The forms of a shape, for help texts."""

Table = Annotated[
    str,
    typer.Option(
        "--table",
        metavar="SHAPE",
        help=f"Shape of the table's top: {SHAPE_HELP}",
        show_default=False,
    ),
]


def parse_shape(option: str, text: str) -> SupportSurface:
    """Reads the shape of a table or of an obstacle.

    Args:
        option: the option's name, for the error's message.
        text: `rectangle:0.8x0.6@0,0` (sides along x and y, then the center), `round:0.5@0.6,0`
            (radius, then the center) or `polygon:0,0;1,0;0,1` (corners), m. A center that is left
            out is the world's origin.

    Returns:
        The shape, as a table's top.

    Raises:
        OptionError: the text is of no such form, or the shape is too large for its lengths to be
            in m.
        PlanningError: a side or radius is not positive, or the polygon crosses itself.
    """

    def read(numbers: str, separator: str, count: int) -> list[float]:
        parts = numbers.split(separator)
        if len(parts) != count:
            raise ValueError
        return [float(part) for part in parts]

    kind, _, rest = text.partition(":")
    size, _, center = rest.partition("@")
    surface = None
    try:
        at = read(center, ",", 2) if center else [0.0, 0.0]
        if kind == "rectangle":
            surface = SupportSurface.rectangle(at, read(size, "x", 2))
        elif kind == "round":
            surface = SupportSurface.round(at, read(size, "x", 1)[0])
        elif kind == "polygon" and not center:
            corners = [read(corner, ",", 2) for corner in rest.split(";")]
            surface = SupportSurface.from_polygon(corners)
    except ValueError:
        pass
    except PlanningError as error:
        raise PlanningError(f"{option}: {str(error).removeprefix('table: ')}") from error
    if surface is None:
        raise OptionError(f"{option}: is {text!r}; expected {SHAPE_FORMS}")
    side = float(np.ptp(surface.corners, axis=0).max())
    if side > MAX_TABLE:
        raise OptionError(
            f"{option}: is {text!r}, which spans {side:g} m: in millimeters? expected m, at most "
            f"{MAX_TABLE:g} a side"
        )
    return surface


@dataclass(frozen=True, eq=False)
class Target:
    """What a command works on: an object, and what is assumed or was learned about it.

    Attributes:
        obj: the object.
        params: masses and frictions of its cells: those of the learned model, or, without one, mass
            and friction spread evenly.
        model: the learned model; None if there is only an object.
    """

    obj: GridObject
    params: CellParameters
    model: Identification | None = None

    def make_physics(self, regime: Regime) -> Physics:
        """Returns the physics that pushes of this target are simulated with.

        They are the model's, or the default ones without a model. A regime other than "auto"
        replaces theirs.
        """
        physics = self.model.physics if self.model else Physics()
        return physics if regime == "auto" else physics.with_regime(regime)


@contextmanager
def executing(
    what: str, workers: int, dask: str | None, open_results: Callable[[], Results]
) -> Iterator[Execution]:
    """Prepares the run of many jobs, whose results are kept in a file and whose progress is shown.

    Args:
        what: the name of the work, such as "campaign", for messages.
        workers: how many processes on this computer do the work.
        dask: address of a cluster that does the work instead; None for this computer.
        open_results: opens the file of results. It is called only after the cluster has answered,
            so that a wrong address leaves no file behind.

    Yields:
        What `jobs.run` needs to run the jobs.

    Raises:
        GridPushError: no cluster answers at the address.
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

        report = stack.enter_context(work_progress(what))
        yield Execution(workers, report, results, prepare, executor)


def check_outputs(
    force: bool, *paths: Path | None, inputs: Sequence[Path | str | None] = ()
) -> None:
    """Checks, before long work begins, that its files can be written at its end.

    Args:
        force: whether existing files may be replaced.
        paths: the files to be written; None for one that the user does not want.
        inputs: the files that are read. None of them may be replaced, not even with `force`.

    Raises:
        OutputError: a file cannot be written, or exists and must not be replaced.
        OptionError: two outputs are the same file, or an output is also an input.
    """
    given = [path for path in paths if path is not None]
    for i, path in enumerate(given):
        if path.resolve() in [other.resolve() for other in given[:i]]:
            raise OptionError(
                f"{path}: is to be written twice; expected a file of its own for each output"
            )
        check_writable(path, force)
        if any(other is not None and is_same(path, other) for other in inputs):
            raise OptionError(
                f"{path}: is also read by this command; expected another file to be written"
            )


def describe_written(*paths: Path | None) -> list[str]:
    """Returns a line that says which files were written, or no line if none was."""
    written = " and ".join(str(path) for path in paths if path is not None)
    return [f"Wrote {written}."] if written else []


def load_object(name: str, largest_piece: bool = False) -> GridObject:
    """Reads an object, given its file or the name of a shipped object.

    Raises:
        ObjectError: there is neither, or the file is not as expected.
    """
    return GridObject.from_yaml(object_path(name), largest_piece=largest_piece)


def object_path(name: str) -> Path:
    """Returns the path of an object's file. A file goes before a shipped object of that name."""
    path = Path(name)
    # a name with an ending is meant as a file, also if that file is not there
    if exists(path) or path.suffix:
        return path
    return find_shipped_object(name)


def load_target(name: str, largest_piece: bool = False) -> Target:
    """Reads an object or a learned model.

    Raises:
        ObjectError: the name is neither a model's file nor an object.
        IdentificationError: it is a model's file, but a damaged one.
    """
    if looks_like_model(name):
        model = read_model(name)
        return Target(model.obj, model.params, model)
    obj = load_object(name, largest_piece)
    return Target(obj, CellParameters.uniform(obj))


def split_name(text: str) -> tuple[str | None, str]:
    """Splits NAME=FILE into the name and the file; the name is None where none is given.

    Raises:
        OptionError: there is an equals sign, but no name before it or no file after it.
    """
    name, separator, file = text.partition("=")
    if not separator:
        return None, text
    if not name or not file:
        raise OptionError(
            f"{text!r} names no {'file' if name else 'object'}; expected NAME=FILE or FILE"
        )
    return name, file


def read_numbers(name: str, text: str, form: str, count: int) -> Array:
    """Reads numbers with commas between them, as an option's value.

    Args:
        name: the option.
        text: its value.
        form: what is expected, for the message.
        count: how many numbers.

    Returns:
        The numbers (count,).

    Raises:
        OptionError: there are not so many, or one is not a finite number.
    """
    try:
        numbers = np.array([float(word) for word in text.split(",")])
    except ValueError:
        numbers = np.empty(0)  # refused below
    if len(numbers) != count or not (np.abs(numbers) <= MAX_NUMBER).all():
        raise OptionError(f"{name}: is {text!r}; expected finite numbers {form}")
    return numbers


def check_names(path: Path, log: PushLog, given: Iterable[str]) -> None:
    """Raises PushLogError where a log has other objects than those that are given."""
    expected = list(given)
    if sorted(log.names) != sorted(expected):
        raise PushLogError(
            f"{path}: has the columns of {', '.join(log.names)}; expected those of "
            f"{', '.join(expected)}. Give each object as NAME=FILE, with the name that its columns "
            "begin with"
        )


def choose_height(given: float | None, obj: GridObject) -> float:
    """Returns the height of an object, m: the given one, else its file's, else DEFAULT_HEIGHT.

    Raises:
        OptionError: the given one is not positive.
    """
    if given is not None:
        if not (isfinite(given) and given > 0):
            raise OptionError(f"--height: is {given:g}; expected a positive number (m)")
        return given
    return obj.height or DEFAULT_HEIGHT


def load_log(
    path: Path, objects: GridObject | Sequence[GridObject], *, require_final: bool = True
) -> PushLog:
    """Reads a push log.

    If the log does not say how thick the pusher was, the objects' files do. If they do not say it
    either, a default is used, which is printed on standard error.

    Args:
        path: the CSV file.
        objects: the object that was pushed, or the objects.
        require_final: whether a push whose last pose is unknown is refused.
    """
    many = [objects] if isinstance(objects, GridObject) else objects
    return give_radius(PushLog.read_csv(path, require_final=require_final), many)


def give_radius(log: PushLog, many: Sequence[GridObject]) -> PushLog:
    """Gives a log the radius of the pusher that its objects' files have; see `load_log`."""
    log.check_objects(many)
    if log.radius_given:
        return log
    radius = find_pusher_radius(many)
    if radius is None:
        names = ", ".join(speak_name(obj.name) for obj in many)
        print_notice(
            f"{names}: its file has no pusher.radius; the pusher's radius is "
            f"assumed to be {DEFAULT_PUSHER_RADIUS:g} m"
        )
        return log
    return log.with_radius(radius)


def choose_radius(radius: float | None, obj: GridObject) -> float:
    """The pusher's radius, m: as given, else as in the object's file, else the shipped finger's.

    Raises:
        OptionError: the radius that was given is not positive, or absurdly large.
    """
    if radius is not None:
        require_positive(OptionError, "--radius: ", "m", radius=radius)
    return choose_pusher_radius(obj, radius)


def make_pusher(radius: float | None, shape: str | None, obj: GridObject) -> Pusher:
    """Makes the pusher of plans: a disc (`choose_radius`), or what `--pusher` says.

    Raises:
        OptionError: both were given, or the radius will not do.
        PushLogError: the shape is of no form that is known.
    """
    if shape is None:
        return Pusher(choose_radius(radius, obj))
    if radius is not None:
        raise OptionError(
            f"--radius: is {radius:g}, the radius of a disc, and --pusher {shape}; expected one of "
            "them"
        )
    return Pusher(shape=parse_pusher("--pusher", shape))


def describe_overhanging(names: Sequence[str]) -> str:
    """Returns a sentence that names the pushes in which the object hung over the table's edge."""
    count = count_noun(len(names), "push")
    listed = ", ".join(names)
    return f"left out {count}, as the object hung over the table's edge: {listed}"


def compile_kernels() -> None:
    """Loads the kernels, or compiles them, before the part of a command that must not be late."""
    compile_all()
