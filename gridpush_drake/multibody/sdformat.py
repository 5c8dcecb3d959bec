"""A grid object as an SDFormat or URDF model, in one file, for Drake's parser.

It has what `AddGridObject` gives a plant: the cells' inertia, a contact sphere a cell, boxes along
and within the outline; the cells are what is seen. SDFormat filters collisions by link and model
only, so nothing is filtered: instead the sides end `SIDE_LIFT` above the table and the spheres are
lower than a finger reaches.

The file supposes that table and pusher are stiff partners: of friction 1, and of point contact
stiffness 1e12 N/m (`contact_material`). Then cell i has friction mu_i, and bears m_i g where the
base is "planar".

URDF says the same of a free object. It has no friction itself: each collision has it, and its
stiffness, in Drake's own elements, which other simulators leave out; the inertia and the shapes are
for anyone.
"""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import ProximityProperties

from gridpush_drake.errors import ObjectError
from gridpush_drake.files import write_whole
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.grid_object import (
    DEFAULT_COLOR,
    DEFAULT_DELTA,
    DEFAULT_HEIGHT,
    SIDE_STIFFNESS,
    SPHERE_RADIUS,
    Base,
    ContactSphereLayout,
    MakeSideProperties,
    MakeSpatialInertia,
    SpheresPerCell,
    make_edge_boxes,
    make_inner_boxes,
    refuse_unphysical,
)
from gridpush_drake.objects.grid_object import GridObject

DRAKE_NAMESPACE = "http://drake.mit.edu"
"""XML namespace of Drake's elements."""

SDFORMAT_VERSION = "1.9"
"""Version of SDFormat."""

SPHERE_GRAVITY = 9.81
"""Gravity that the spheres are made for, m/s²; Drake's own."""

SIDE_LIFT = 0.003
"""Height of the sides' lower edge over the object's bottom, m; more than the spheres are pressed
in."""

SDF_NOTICE = (
    " A grid object: a sphere under every cell, boxes along the outline for a finger to push. "
    "Table and finger are to have friction 1 and drake:point_contact_stiffness 1e12. The object's "
    "bottom is z = 0 of its frame. Units: m, kg. "
)

Element = ElementTree.Element


def make_sdf(
    model: Model,
    base: Base = "free",
    *,
    height: float = DEFAULT_HEIGHT,
    delta: float | None = None,
    spheres_per_cell: SpheresPerCell = 1,
    side_stiffness: float = SIDE_STIFFNESS,
    gravity: float = SPHERE_GRAVITY,
    note: str = "",
) -> str:
    """Makes the model's text; the model and its link have the object's name.

    Args:
        model: one object, with its parameters.
        base: "free", or "planar": held by a planar joint to a frame `delta` below the world's z =
            0.
        height: height of the object, m; more than `SIDE_LIFT`.
        delta: how far the spheres are pressed in at rest, m; by default as in `AddGridObject`.
        spheres_per_cell: 1 or 4, see `AddGridObject`.
        side_stiffness: stiffness of the outline's contacts, N/m.
        gravity: gravity that the spheres are made for, m/s².
        note: a further comment for whoever reads the file, such as how well its numbers are known.

    Raises:
        ObjectError: `base` is neither, a size is out of range, or SDFormat has no such names.
        ParameterError: the parameters are of another number of cells, a friction is 2 or more, or
            Drake finds the masses unphysical.
    """
    obj = model.obj
    if base not in DEFAULT_DELTA:
        raise ObjectError(f"base is {base!r}; expected 'planar' or 'free'")
    is_reserved = obj.name == "world" or (obj.name[:2] == obj.name[-2:] == "__")
    if not obj.name or "::" in obj.name or is_reserved:
        raise ObjectError(
            f"name is {obj.name!r}; expected one that SDFormat has not reserved, without '::'"
        )
    delta = DEFAULT_DELTA[base] if delta is None else delta
    if not SIDE_LIFT < height < np.inf:
        raise ObjectError(f"height is {height!r}; expected more than {SIDE_LIFT} m")
    if not 0 < delta < SIDE_LIFT:
        raise ObjectError(f"delta is {delta!r}; expected more than 0 and less than {SIDE_LIFT} m")
    ElementTree.register_namespace("drake", DRAKE_NAMESPACE)
    sdf = Element("sdf", version=SDFORMAT_VERSION)
    sdf.append(ElementTree.Comment(SDF_NOTICE))
    add_note(sdf, note)
    element = ElementTree.SubElement(sdf, "model", name=obj.name)
    link = ElementTree.SubElement(element, "link", name=obj.name)
    layout = ContactSphereLayout.for_object(obj, spheres_per_cell)
    _add_inertia(link, model, height)
    _add_spheres(link, model, layout, delta, gravity)
    _add_sides(link, model, height, side_stiffness)
    _add_cells(link, obj, height)
    if base == "planar":
        _add_joint(element, obj.name, delta)
    ElementTree.indent(sdf)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(sdf, encoding="unicode") + "\n"


def WriteSdf(
    model: Model,
    path: Path | str,
    force: bool = False,
    *,
    base: Base = "free",
    height: float = DEFAULT_HEIGHT,
    spheres_per_cell: SpheresPerCell = 1,
    note: str = "",
) -> None:
    """Writes what `make_sdf` makes to a file.

    Raises:
        OutputError: the file exists and `force` is not set, or it cannot be written.
    """
    text = make_sdf(model, base, height=height, spheres_per_cell=spheres_per_cell, note=note)
    write_whole(path, text, force)


def add_note(parent: Element, note: str) -> None:
    """Adds a comment, where there is one to add; XML allows no two hyphens within."""
    if note:
        parent.append(ElementTree.Comment(f" {note.replace('--', '- -')} "))


def _add_inertia(link: Element, model: Model, height: float) -> None:
    """Adds mass, center of mass and the inertia about it."""
    M_BBo_B = MakeSpatialInertia(model, height)
    with refuse_unphysical(model):
        I_BBcm_B = M_BBo_B.Shift(M_BBo_B.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
    inertial = ElementTree.SubElement(link, "inertial")
    _add(inertial, "pose", [*M_BBo_B.get_com(), 0, 0, 0])
    _add(inertial, "mass", [M_BBo_B.get_mass()])
    inertia = ElementTree.SubElement(inertial, "inertia")
    for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        _add(inertia, f"i{'xyz'[i]}{'xyz'[j]}", [I_BBcm_B[i, j]])


def _add_spheres(
    link: Element,
    model: Model,
    layout: ContactSphereLayout,
    delta: float,
    gravity: float,
) -> None:
    """Adds the contact spheres below the cells."""
    properties = layout.make_properties(model.params, delta, gravity)
    for i, (x, y) in enumerate(layout.p_BS):
        geometry = _add_collision(
            link, f"sphere_{i}", [x, y, SPHERE_RADIUS, 0, 0, 0], properties[i]
        )
        _add(ElementTree.SubElement(geometry, "sphere"), "radius", [SPHERE_RADIUS])


def _add_sides(link: Element, model: Model, height: float, stiffness: float) -> None:
    """Adds the boxes along and within the outline."""
    obj = model.obj
    properties = MakeSideProperties(model.params, stiffness)
    for kind, boxes in (("edge", make_edge_boxes(obj)), ("inside", make_inner_boxes(obj))):
        for i, flat in enumerate(boxes):
            pose = [*flat.center, (height + SIDE_LIFT) / 2, 0, 0, flat.angle]
            geometry = _add_collision(link, f"{kind}_{i}", pose, properties)
            _add(ElementTree.SubElement(geometry, "box"), "size", [*flat.size, height - SIDE_LIFT])


def _add_cells(link: Element, obj: GridObject, height: float) -> None:
    """Adds the cells, which are seen and touch nothing."""
    for i, (x, y) in enumerate(obj.p_BC):
        visual = ElementTree.SubElement(link, "visual", name=f"cell_{i}")
        _add(visual, "pose", [x, y, height / 2, 0, 0, 0])
        geometry = ElementTree.SubElement(visual, "geometry")
        _add(
            ElementTree.SubElement(geometry, "box"), "size", [obj.cell_size, obj.cell_size, height]
        )
        _add(ElementTree.SubElement(visual, "material"), "diffuse", DEFAULT_COLOR)


def _add_joint(model: Element, link: str, delta: float) -> None:
    """Holds the object to a link that is fixed to the world, `delta`, m, below its plane z = 0.

    The link is needed, for Drake's joints in SDFormat know no world.
    """
    support = f"{link}_support"
    parent = ElementTree.SubElement(model, "link", name=support)
    _add(parent, "pose", [0, 0, -delta, 0, 0, 0])
    fixed = ElementTree.SubElement(model, "joint", name=f"{support}_fixed", type="fixed")
    ElementTree.SubElement(fixed, "parent").text = "world"
    ElementTree.SubElement(fixed, "child").text = support
    joint = ElementTree.SubElement(
        model, f"{{{DRAKE_NAMESPACE}}}joint", name=f"{link}_planar", type="planar"
    )
    ElementTree.SubElement(joint, f"{{{DRAKE_NAMESPACE}}}parent").text = support
    ElementTree.SubElement(joint, f"{{{DRAKE_NAMESPACE}}}child").text = link
    _add(joint, f"{{{DRAKE_NAMESPACE}}}damping", [0, 0, 0])


def _add_collision(
    link: Element, name: str, pose: ArrayLike, properties: ProximityProperties
) -> Element:
    """Adds a collision and returns its empty geometry."""
    collision = ElementTree.SubElement(link, "collision", name=name)
    _add(collision, "pose", pose)
    geometry = ElementTree.SubElement(collision, "geometry")
    contact = ElementTree.SubElement(collision, f"{{{DRAKE_NAMESPACE}}}proximity_properties")
    friction = properties.GetProperty("material", "coulomb_friction")
    _add(contact, f"{{{DRAKE_NAMESPACE}}}mu_static", [friction.static_friction()])
    _add(contact, f"{{{DRAKE_NAMESPACE}}}mu_dynamic", [friction.dynamic_friction()])
    for name in ("point_contact_stiffness", "hunt_crossley_dissipation"):
        _add(contact, f"{{{DRAKE_NAMESPACE}}}{name}", [properties.GetProperty("material", name)])
    return geometry


def _add(parent: Element, tag: str, values: ArrayLike) -> None:
    """Adds numbers, so written that they are read back exactly."""
    texts = [repr(float(value)) for value in np.asarray(values)]
    ElementTree.SubElement(parent, tag).text = " ".join(texts)


URDF_NOTICE = (
    " Friction and stiffness are in Drake's elements alone: other simulators see shapes and "
    "inertia only. "
)
"""Notice in a URDF file, besides `SDF_NOTICE`."""


def make_urdf(model: Model, *, height: float = DEFAULT_HEIGHT, note: str = "") -> str:
    """Makes the text of a URDF model, whose robot and link have the object's name.

    Args:
        model: one object, with its parameters.
        height: its height, m.
        note: a further comment for whoever reads the file.

    Raises:
        ObjectError, ParameterError: as `make_sdf`.
    """
    obj = model.obj
    # It is the SDFormat model, said in URDF's words.
    source = ElementTree.fromstring(make_sdf(model, height=height)).find("model/link")
    assert source is not None
    robot = Element("robot", name=obj.name)
    robot.append(ElementTree.Comment(SDF_NOTICE + URDF_NOTICE))
    add_note(robot, note)
    link = ElementTree.SubElement(robot, "link", name=obj.name)
    for part in source:
        made = ElementTree.SubElement(link, part.tag, part.attrib)
        x, y, z, *angles = _read(part, "pose").split()
        ElementTree.SubElement(made, "origin", xyz=f"{x} {y} {z}", rpy=" ".join(angles))
        if part.tag == "inertial":
            ElementTree.SubElement(made, "mass", value=_read(part, "mass"))
            ElementTree.SubElement(
                made, "inertia", {entry.tag: _read(entry) for entry in part.iterfind("inertia/*")}
            )
            continue
        _add_shape(made, part)
        for color in part.iterfind("material/diffuse"):
            material = ElementTree.SubElement(made, "material", name="cell")
            ElementTree.SubElement(material, "color", rgba=_read(color))
        for given in part.iterfind(f"{{{DRAKE_NAMESPACE}}}proximity_properties"):
            properties = ElementTree.SubElement(made, given.tag)
            for entry in given:
                ElementTree.SubElement(properties, entry.tag, value=_read(entry))
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def WriteUrdf(
    model: Model,
    path: Path | str,
    force: bool = False,
    *,
    height: float = DEFAULT_HEIGHT,
    note: str = "",
) -> None:
    """Writes what `make_urdf` makes to a file.

    Raises:
        OutputError: the file exists and `force` is not set, or it cannot be written.
    """
    write_whole(path, make_urdf(model, height=height, note=note), force)


def _add_shape(made: Element, part: Element) -> None:
    """Says a part's shape in URDF's words."""
    (shape,) = part.iterfind("geometry/*")
    geometry = ElementTree.SubElement(made, "geometry")
    ElementTree.SubElement(geometry, shape.tag, {size.tag: _read(size) for size in shape})


def _read(element: Element, path: str = ".") -> str:
    """Reads the text of an element, or of one within it that must be there."""
    found = element.find(path)
    assert found is not None
    return found.text or ""
