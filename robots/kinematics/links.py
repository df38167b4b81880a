"""The visual shapes of the arm: primitive shapes of its URDF, and the poses of its links."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from pickproof.cell.frames import Array, make_transform
from pickproof.robots.kinematics.model import RobotModel

GREY = (0.6, 0.6, 0.6)


@dataclass(frozen=True, eq=False)
class LinkShape:
    """One visual shape of a link.

    Attributes:
        T_link_shape: (4, 4); a cylinder's axis is its z.
        size: edge lengths of a box, or radius and length of a cylinder, in [m].
        rgb: each in [0, 1].
    """

    link: str
    kind: Literal["box", "cylinder"]
    T_link_shape: Array
    size: tuple[float, ...]
    rgb: tuple[float, float, float]


def link_shapes(model: RobotModel) -> list[LinkShape]:
    """Boxes and cylinders of the arm's URDF, in its order; meshes are left out."""
    root = ElementTree.parse(model.urdf).getroot()
    colours = {m.get("name"): _rgb(m) for m in root.findall("material")}
    shapes = []
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            material = visual.find("material")
            rgb = GREY if material is None else colours.get(material.get("name")) or _rgb(material) or GREY
            shapes += [
                LinkShape(str(link.get("name")), kind, _origin(visual), size, rgb) for kind, size in _primitives(visual)
            ]
    return shapes


def link_poses(model: RobotModel, q: Array) -> dict[str, Array]:
    """T_base_link (n, 4, 4) of every link with a shape, at joint vectors q (n, 6) in [rad]."""
    names = dict.fromkeys(shape.link for shape in link_shapes(model))
    frames = {name: model.kinematics.getFrameId(name) for name in names}
    poses = {name: np.empty((len(q), 4, 4)) for name in names}
    data = model.kinematics.createData()
    for k, row in enumerate(q):
        pin.framesForwardKinematics(model.kinematics, data, row)
        for name, frame in frames.items():
            poses[name][k] = data.oMf[frame].homogeneous
    return poses


def _primitives(visual: ElementTree.Element) -> Iterator[tuple[Literal["box", "cylinder"], tuple[float, ...]]]:
    for box in visual.iterfind("geometry/box"):
        yield "box", _floats(box.get("size"))
    for cylinder in visual.iterfind("geometry/cylinder"):
        yield "cylinder", (float(cylinder.get("radius", 0)), float(cylinder.get("length", 0)))


def _origin(visual: ElementTree.Element) -> Array:
    origin = visual.find("origin")
    if origin is None:
        return np.eye(4)
    angles = _floats(origin.get("rpy")) or (0.0, 0.0, 0.0)
    return make_transform(Rotation.from_euler("xyz", angles).as_matrix(), _floats(origin.get("xyz")) or (0.0, 0.0, 0.0))


def _rgb(material: ElementTree.Element) -> tuple[float, float, float] | None:
    colour = material.find("color")
    if colour is None:
        return None
    r, g, b, *_ = _floats(colour.get("rgba"))
    return r, g, b


def _floats(text: str | None) -> tuple[float, ...]:
    return tuple(float(x) for x in (text or "").split())
