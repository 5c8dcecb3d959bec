"""A grid object as a MuJoCo model (MJCF), in one file: a free body with a foot under every cell.

The body's feet are as stiff as their cells are heavy, so that it sinks evenly and each cell bears
its own weight, the model's assumption. A finger touches a thin ring along the outline at the height
that the model supposes, 0 unless it was told another: pushed above the table, a rigid body's load
moves forward.

MuJoCo's contacts slip a little when they stick, and are lifted by slip when they slide. Both follow
from four numbers. With R the regularization of a contact's normal force f, d its impedance
(`solimp`) and b what its slip v is damped with (`solreffriction`), R f is the body's weight on the
foot as acceleration over d, and

    creep of a sticking foot at the cone's edge        mu R f / (b impratio)
    load that slip feigns, relative to the foot's own  mu b v / (R f)
    time by which friction's direction lags            1 / b

so R f, here FOOT_REGULARIZATION, is to be large, which a small impedance gives, and `impratio` very
large.
"""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.errors import ObjectError
from gridpush_drake.files import write_whole
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.sdformat import add_note

TIME_STEP = 1e-3
"""Time step of the model, s."""

FOOT_RADIUS = 0.002
"""Radius of the spheres that stand on the table, m."""

WALL_RADIUS = 1e-4
"""Radius of the capsules along the outline, which the pusher touches, m. The pusher's own radius
should be less by as much."""

FOUNDATION_SINKAGE = 2e-4
"""How far a compliant bottom sinks under its weight, m."""

DAMPING_RATIO = 0.3
"""Damping ratio of the body's motion up and down on its feet. It is small, for it acts explicitly
in time, and rocking, which is faster, must stay stable."""

FOOT_REGULARIZATION = 1e3
"""Term R f of a foot, m/s²; see the head of this module."""

SLIP_DAMPING = 200.0
"""Damping b of slip, 1/s; see the head of this module."""

IMPEDANCE_RATIO = 1e5
"""Ratio by which friction is stiffer than the normal force, MuJoCo's `impratio`."""

SOLVER_TOLERANCE = 1e-12
"""Tolerance of MuJoCo's solver."""

MIN_IMPEDANCE = 1e-4
"""Smallest impedance that MuJoCo takes."""

TABLE_HALF = 5.0
"""Half a side of the table, m."""

WALL_IMPEDANCE = 0.99
"""Impedance of the ring where a finger touches it."""

WALL_TIME = 0.002
"""Time in which the ring comes back where it gave way, s."""

MJCF_NOTICE = (
    "\n"
    "  A grid object on a table. Units: m, kg, rad. The object's frame has its origin at "
    "the bottom, z = 0.\n"
    "\n"
    "  What is said: each cell's mass (cell_0, ...), each cell's friction against the "
    "table (the pairs), the pusher's\n"
    "  friction (wall_0, ..., whose priority puts it before the finger's own).\n"
    "  What MJCF cannot say: that a cell spins on its patch (a foot is a point). That a "
    "finger pushes at a given height: here\n"
    "  it touches the ring of walls at z = {height:g} alone, however long it is. How stiff "
    "feet are relative to each other is\n"
    "  made for this table's gravity and for feet that all stand on it: beyond an edge "
    "loads would shift otherwise.\n"
    "  The options belong to the model: elliptic cones and a large impratio keep feet from "
    "creeping.\n"
    "  Use: a finger is a vertical capsule or cylinder of a body of yours that reaches "
    "below z = {height:g}, its radius less\n"
    "  by {wall:g} m, kept from the table by an exclude of world and that body; move it "
    "slowly.\n"
)
"""What the file says of itself: what it is, what it cannot say, and how it is used."""

Element = ElementTree.Element


def calc_springs(load: Array, sinkage: float, inverse: float) -> tuple[Array, Array, Array]:
    """Calculates MuJoCo's numbers for contacts that give way under loads.

    The force is stiffness times depth, at any depth, as the impedance does not vary with it.

    Args:
        load: (K,) loads of the contacts, N.
        sinkage: how far they give way, m.
        inverse: inverse of the mass that MuJoCo takes for granted (`body_invweight0`), 1/kg.

    Returns:
        `solref` (K, 2), `solreffriction` (K, 2), and the impedance (K,), the first two entries of
        `solimp`.
    """
    impedance = np.maximum(inverse / (inverse + FOOT_REGULARIZATION / load), MIN_IMPEDANCE)
    stiffness = load / sinkage
    damping = 2 * DAMPING_RATIO * load / np.sqrt(sinkage * GRAVITY)
    scale = inverse * (1 - impedance)
    # Negative numbers are stiffness and damping themselves, and no time and ratio.
    springs = np.column_stack([-stiffness * scale, -damping * scale])
    slip = np.column_stack([-np.ones_like(load), -SLIP_DAMPING * impedance])
    return springs, slip, impedance


def make_mjcf(model: Model, height: float, note: str = "") -> str:
    """Makes the model's text: a table at z = 0 and the object on it.

    Args:
        model: one object, with its parameters.
        height: its height, m.
        note: a further comment for whoever reads the file, such as how well its numbers are known.

    Raises:
        ObjectError: the object's name is empty, or the height is not more than the feet's.
    """
    obj = model.obj
    params = model.params
    if not obj.name:
        raise ObjectError("name is empty; expected one for the body")
    if not FOOT_RADIUS < height < np.inf:
        raise ObjectError(f"height is {height!r}; expected more than {FOOT_RADIUS} m")
    mujoco = Element("mujoco", model=obj.name)
    mujoco.append(
        ElementTree.Comment(MJCF_NOTICE.format(height=params.push_height, wall=WALL_RADIUS))
    )
    add_note(mujoco, note)
    _add(
        mujoco,
        "option",
        timestep=TIME_STEP,
        cone="elliptic",
        impratio=IMPEDANCE_RATIO,
        tolerance=SOLVER_TOLERANCE,
        gravity=(0, 0, -GRAVITY),
    )
    world = ElementTree.SubElement(mujoco, "worldbody")
    _add(
        world,
        "geom",
        name="table",
        type="plane",
        size=(TABLE_HALF, TABLE_HALF, 1),
        friction=(1, 0, 0),
    )
    body = _add(world, "body", name=obj.name, pos=(0, 0, 0))
    _add(body, "freejoint", name=obj.name)
    _add_cells(body, model, height)
    for i, p in enumerate(obj.p_BC):
        _add(
            body,
            "geom",
            name=f"foot_{i}",
            type="sphere",
            size=FOOT_RADIUS,
            pos=(*p, FOOT_RADIUS),
            mass=0,
            contype=0,
            conaffinity=0,
            group=3,
        )
    _add_walls(body, model)
    contact = ElementTree.SubElement(mujoco, "contact")
    _add(contact, "exclude", body1="world", body2=obj.name)  # but for the pairs
    springs, slip, impedance = calc_springs(
        params.mass * GRAVITY, FOUNDATION_SINKAGE, 1 / params.total_mass
    )
    for i, mu in enumerate(params.friction):
        _add(
            contact,
            "pair",
            geom1="table",
            geom2=f"foot_{i}",
            condim=3,
            friction=(mu, mu, 0, 0, 0),
            solref=springs[i],
            solreffriction=slip[i],
            solimp=(impedance[i], impedance[i], 0.001, 0.5, 2),
        )
    ElementTree.indent(mujoco)
    return ElementTree.tostring(mujoco, encoding="unicode") + "\n"


def WriteMjcf(
    model: Model,
    path: Path | str,
    force: bool,
    *,
    height: float,
    note: str = "",
) -> None:
    """Writes the model to a file.

    Args:
        model: one object, with its parameters.
        path: the file.
        force: whether an existing file may be replaced.
        height: the object's height, m.
        note: a further comment for whoever reads the file.

    Raises:
        OutputError: the file cannot be written.
        ObjectError: as `make_mjcf`.
    """
    write_whole(path, make_mjcf(model, height, note), force)


def _add_cells(body: Element, model: Model, height: float) -> None:
    """Adds the cells, which are seen and weigh, but touch nothing."""
    obj = model.obj
    half = obj.cell_size / 2
    for i, (p, mass) in enumerate(zip(obj.p_BC, model.params.mass, strict=True)):
        _add(
            body,
            "geom",
            name=f"cell_{i}",
            type="box",
            size=(half, half, height / 2),
            pos=(*p, height / 2),
            mass=mass,
            contype=0,
            conaffinity=0,
        )


def _add_walls(body: Element, model: Model) -> None:
    """Adds the ring along the outline that a finger touches."""
    obj = model.obj
    params = model.params
    z = params.push_height
    for i, (a, b) in enumerate(zip(obj.edges.start, obj.edges.end, strict=True)):
        _add(
            body,
            "geom",
            name=f"wall_{i}",
            type="capsule",
            size=WALL_RADIUS,
            fromto=(*a, z, *b, z),
            mass=0,
            group=3,
            friction=(params.contact_friction, 0, 0),
            priority=1,
            condim=3,
            solref=(WALL_TIME, 1),
            solimp=(WALL_IMPEDANCE, WALL_IMPEDANCE, 0.001, 0.5, 2),
        )


def _add(parent: Element, tag: str, **values: ArrayLike) -> Element:
    """Adds an element, its numbers so written that they are read back exactly."""
    texts = {
        name: value if isinstance(value, str) else _write(value) for name, value in values.items()
    }
    return ElementTree.SubElement(parent, tag, texts)


def _write(values: ArrayLike) -> str:
    """Writes numbers with blanks between them, so that they are read back exactly."""
    return " ".join(
        repr(int(value)) if float(value).is_integer() else repr(float(value))
        for value in np.ravel(np.asarray(values))
    )
