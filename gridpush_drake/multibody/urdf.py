"""A grid object as a URDF model, in one file, for Drake's parser: what `make_sdf` says of a free object.

URDF itself has no friction. Each collision has it, and its stiffness, in Drake's own elements, which other simulators
leave out; the inertia and the shapes are for anyone. Nothing else is lost.
"""

from pathlib import Path
from xml.etree import ElementTree

from gridpush_drake.files import write_whole
from gridpush_drake.multibody.grid_object import DEFAULT_HEIGHT
from gridpush_drake.multibody.sdformat import DRAKE, NOTICE, make_sdf
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

LIMIT = " Friction and stiffness are in Drake's elements alone: other simulators see shapes and inertia only. "

Element = ElementTree.Element


def make_urdf(obj: GridObject, params: CellParameters, *, height: float = DEFAULT_HEIGHT) -> str:
    """Makes the model's text.

    Args:
        obj: the object.
        params: what its cells weigh and how they rub.
        height: of the object, m.

    Returns:
        URDF; the robot and its link have the object's name.

    Raises:
        ObjectError, ParameterError: as `sdformat.make_sdf`.
    """
    source = ElementTree.fromstring(make_sdf(obj, params, height=height)).find("model/link")
    assert source is not None
    robot = Element("robot", name=obj.name)
    robot.append(ElementTree.Comment(NOTICE + LIMIT))
    link = ElementTree.SubElement(robot, "link", name=obj.name)
    for part in source:
        made = ElementTree.SubElement(link, part.tag, part.attrib)
        x, y, z, *angles = _read(part, "pose").split()
        ElementTree.SubElement(made, "origin", xyz=f"{x} {y} {z}", rpy=" ".join(angles))
        if part.tag == "inertial":
            ElementTree.SubElement(made, "mass", value=_read(part, "mass"))
            ElementTree.SubElement(made, "inertia", {entry.tag: _read(entry) for entry in part.iterfind("inertia/*")})
            continue
        _add_shape(made, part)
        for color in part.iterfind("material/diffuse"):
            material = ElementTree.SubElement(made, "material", name="cell")
            ElementTree.SubElement(material, "color", rgba=_read(color))
        for given in part.iterfind(f"{{{DRAKE}}}proximity_properties"):
            properties = ElementTree.SubElement(made, given.tag)
            for entry in given:
                ElementTree.SubElement(properties, entry.tag, value=_read(entry))
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def WriteUrdf(
    obj: GridObject, params: CellParameters, path: Path | str, force: bool = False, *, height: float = DEFAULT_HEIGHT
) -> None:
    """Writes the model to a file.

    Args:
        obj: the object.
        params: what its cells weigh and how they rub.
        path: the file.
        force: whether an existing file may be replaced.
        height: of the object, m.

    Raises:
        OutputError: the file cannot be written.
        ObjectError, ParameterError: as `make_urdf`.
    """
    write_whole(path, make_urdf(obj, params, height=height), force)


def _add_shape(made: Element, part: Element) -> None:
    (shape,) = part.iterfind("geometry/*")
    geometry = ElementTree.SubElement(made, "geometry")
    ElementTree.SubElement(geometry, shape.tag, {size.tag: _read(size) for size in shape})


def _read(element: Element, path: str = ".") -> str:
    found = element.find(path)
    assert found is not None
    return found.text or ""
