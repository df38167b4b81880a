"""One URDF of arm and gripper: the gripper's links are written under the arm's flange link."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array
from pickproof.cell.grippers.base import Gripper, Triple, in_frame
from pickproof.cell.workpiece.collision_pieces import CollisionBox, CollisionCylinder, enclosing_box

BODY = "gripper_body"
GREY, ORANGE = "0.16 0.17 0.19 1", "0.85 0.42 0.20 1"

Shape = CollisionBox | CollisionCylinder


def merged_urdf(urdf: Path, gripper: Gripper, flange: str) -> str:
    """The text of `urdf` with the gripper fixed to link `flange`.

    The links that touch workpieces have prismatic joints named `<link>_joint`. The joint of a finger is 0 when its pad
    is at the centre, the joint of cups or magnets when their spring is at rest.

    Raises:
        InputError: the file is missing or not XML, or has no such link.
    """
    try:
        root = ElementTree.fromstring(urdf.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, ElementTree.ParseError) as error:
        raise InputError(urdf, "", str(error), "a readable URDF") from None
    links = [str(link.get("name")) for link in root.iter("link")]
    if flange not in links:
        raise InputError(urdf, "link", flange, f"one of: {', '.join(links)}")
    for mesh in root.iter("mesh"):
        mesh.set("filename", str((urdf.parent / str(mesh.get("filename"))).resolve()))
    for link in root.iter("link"):
        if link.find("inertial") is None:  # PyBullet would give it 1 kg
            _inertial(link, 1e-3, (0.01, 0.01, 0.01), (0.0, 0.0, 0.0))
    body = in_frame(gripper.body_boxes(), gripper.T_flange_tool)
    _link(root, BODY, [CollisionBox(size=b.size, centre=_triple(b.T_world_box)) for b in body], gripper.body_mass, GREY)
    _joint(root, f"{BODY}_joint", "fixed", flange, BODY)
    for part in gripper.links():
        _link(root, part.name, part.shapes, part.mass, ORANGE)
        joint = _joint(root, f"{part.name}_joint", "prismatic", BODY, part.name)
        ElementTree.SubElement(joint, "axis", xyz=" ".join(f"{a:g}" for a in part.axis))
        ElementTree.SubElement(
            joint, "limit", lower="0", upper=str(part.travel), effort="1000", velocity=str(part.speed)
        )
    return ElementTree.tostring(root, encoding="unicode")


def _link(root: ElementTree.Element, name: str, shapes: Sequence[Shape], mass: float, rgba: str) -> None:
    link = ElementTree.SubElement(root, "link", name=name)
    size, T = max((enclosing_box(piece) for piece in shapes), key=lambda box: box[0][0] * box[0][1] * box[0][2])
    _inertial(link, mass, size, _triple(T))
    for piece in shapes:
        for kind in ("visual", "collision"):
            shape = ElementTree.SubElement(link, kind)
            origin = ElementTree.SubElement(shape, "origin", xyz=_text(piece.centre))
            if any(piece.rpy):
                origin.set("rpy", _text(piece.rpy))
            geometry = ElementTree.SubElement(shape, "geometry")
            if isinstance(piece, CollisionBox):
                ElementTree.SubElement(geometry, "box", size=_text(piece.size))
            else:
                ElementTree.SubElement(geometry, "cylinder", radius=str(piece.radius), length=str(piece.length))
            if kind == "visual":
                material = ElementTree.SubElement(shape, "material", name=f"{name}_colour")
                ElementTree.SubElement(material, "color", rgba=rgba)


def _inertial(link: ElementTree.Element, mass: float, size: tuple[float, ...], centre: tuple[float, ...]) -> None:
    """Mass and the inertia of a solid box."""
    x, y, z = (s * s for s in size)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=_text(centre))
    ElementTree.SubElement(inertial, "mass", value=str(mass))
    moments = {"ixx": y + z, "iyy": x + z, "izz": x + y}
    inertia = ElementTree.SubElement(inertial, "inertia", ixy="0", ixz="0", iyz="0")
    for key, value in moments.items():
        inertia.set(key, repr(float(mass / 12 * value)))


def _joint(root: ElementTree.Element, name: str, kind: str, parent: str, child: str) -> ElementTree.Element:
    joint = ElementTree.SubElement(root, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    return joint


def _triple(T: Array) -> Triple:
    """Origin of a transform (4, 4)."""
    x, y, z = T[:3, 3].tolist()
    return x, y, z


def _text(values: object) -> str:
    return " ".join(repr(float(v)) for v in values)  # type: ignore[attr-defined]
