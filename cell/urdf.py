"""One URDF of arm and gripper: the gripper's links are written under the arm's flange link."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

from cell.bin import Box
from cell.errors import InputError
from cell.gripper import Gripper

FINGERS = ("finger_left", "finger_right")
BODY = "gripper_body"


def merged_urdf(urdf: Path, gripper: Gripper, flange: str) -> str:
    """The text of `urdf` with the gripper fixed to link `flange`.

    The fingers are prismatic joints named `<finger>_joint`, each 0 when its pad is at the centre.

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
    body, fingers = gripper.flange_boxes(0.0)[:-2], gripper.flange_boxes(0.0)[-2:]
    _link(root, BODY, body, gripper.body_mass, "0.16 0.17 0.19 1")
    _joint(root, f"{BODY}_joint", "fixed", flange, BODY)
    for name, box, axis in zip(FINGERS, fingers, ("-1 0 0", "1 0 0"), strict=True):
        _link(root, name, [box], gripper.finger_mass, "0.85 0.42 0.20 1")
        joint = _joint(root, f"{name}_joint", "prismatic", BODY, name)
        ElementTree.SubElement(joint, "axis", xyz=axis)
        ElementTree.SubElement(
            joint, "limit", lower="0", upper=str(gripper.max_opening / 2), effort="1000", velocity=str(gripper.speed)
        )
    return ElementTree.tostring(root, encoding="unicode")


def _link(root: ElementTree.Element, name: str, boxes: list[Box], mass: float, rgba: str) -> None:
    link = ElementTree.SubElement(root, "link", name=name)
    largest = max(boxes, key=lambda b: b.size[0] * b.size[1] * b.size[2])
    _inertial(link, mass, largest.size, tuple(largest.T_world_box[:3, 3]))
    for box in boxes:
        for kind in ("visual", "collision"):
            shape = ElementTree.SubElement(link, kind)
            ElementTree.SubElement(shape, "origin", xyz=_text(box.T_world_box[:3, 3]))
            ElementTree.SubElement(ElementTree.SubElement(shape, "geometry"), "box", size=_text(box.size))
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


def _text(values: object) -> str:
    return " ".join(repr(float(v)) for v in values)  # type: ignore[attr-defined]
