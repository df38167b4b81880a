"""A settled heap of brackets seen by the cell's camera, and votes as a network of a given quality would give them."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np
import torch
import trimesh
from scipy.spatial.transform import Rotation

from pickproof.cell.frames import Array, invert
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.physics.bin_filling import fill_bin
from pickproof.cell.physics.world import World
from pickproof.cell.sensing.camera import DepthFrame, Intrinsics, RenderOptions, look_at, render
from pickproof.cell.sensing.sensor_model import SensorConfig, measure
from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.perception.ps6d.votes import Votes

torch.set_num_threads(1)

BIN = Bin("bin", (0.18, 0.13, 0.06), 0.004, (0.0, 0.0, 0.0))
INTRINSICS = Intrinsics.from_fov(640, 480, 2 * np.arctan(0.15 / 0.85))


@dataclass(frozen=True)
class Scene:
    """A measured frame with its truth: poses (n, 4, 4), pixels seen of each (n,), instance of each pixel (h, w)."""

    workpiece: Workpiece
    frame: DepthFrame
    Ts_camera_part: Array
    pixels: np.ndarray
    ids: np.ndarray


def look(workpiece: Workpiece, Ts_world_part: Array, seed: int = 0, noise: bool = True) -> Scene:
    """Render poses in the bin from 0.85 m above and measure them."""
    sensor = SensorConfig(enabled=noise)
    T_world_camera = look_at(np.array([0.0, 0.0, 0.85]), np.zeros(3))
    view = (INTRINSICS, T_world_camera)
    mesh, options = (workpiece.vertices, workpiece.faces), RenderOptions(sensor.projector_offset)
    exact = render(*mesh, Ts_world_part, BIN.boxes(), *view, options)
    frame = measure(exact, *view, sensor, np.random.default_rng(seed))
    pixels = np.bincount(exact.ids[exact.ids >= 0], minlength=len(Ts_world_part))
    return Scene(workpiece, frame, invert(T_world_camera) @ Ts_world_part, pixels, exact.ids)


@functools.lru_cache(maxsize=2)
def heap(count: int = 12, seed: int = 0) -> Scene:
    """Brackets dropped into the bin."""
    workpiece = load_workpiece("bracket")
    world = World()
    world.add_bin(BIN)
    fallen = fill_bin(world, workpiece, BIN, count, np.random.default_rng(seed))
    world.close()
    return look(workpiece, fallen.Ts_world_part[fallen.inside], seed)


def votes_of(scene: Scene, seed: int, position: float, angle_deg: float, outliers: float, count: int = 700) -> Votes:
    """Votes with median errors `position` [unit] and `angle_deg`; a share `outliers` has a random rotation."""
    rng = np.random.default_rng(seed)
    points, pixels = scene.frame.points_camera()
    instance = scene.ids[pixels[:, 0], pixels[:, 1]]
    chosen = rng.choice(np.flatnonzero(instance >= 0), count, replace=False)
    p, T = points[chosen] / scene.workpiece.unit, scene.Ts_camera_part[instance[chosen]]
    # the norm of three Gaussians has the median 1.538 sigma
    turn = Rotation.from_rotvec(rng.normal(0, np.deg2rad(angle_deg) / 1.538, (count, 3))).as_matrix()
    R = turn @ T[:, :3, :3]
    wrong = rng.random(count) < outliers
    R[wrong] = Rotation.random(int(wrong.sum()), random_state=rng).as_matrix()
    t = T[:, :3, 3] / scene.workpiece.unit + rng.normal(0, position / 1.538, (count, 3))
    return Votes(p, t, R, np.einsum("nji,nj->ni", R, p - t))


def solid(mesh: trimesh.Trimesh, degrees: tuple[float, float, float]) -> Workpiece:
    """A workpiece of another shape and symmetry."""
    return replace(
        load_workpiece("bracket"),
        name="solid",
        vertices=np.array(mesh.vertices),
        faces=np.array(mesh.faces),
        symmetry=Symmetry(degrees),
    )


def bar() -> Workpiece:
    """A 60 x 20 x 10 mm block, which half turns about each axis leave unchanged."""
    return solid(trimesh.creation.box((0.06, 0.02, 0.01)), (180.0, 180.0, 180.0))


def rod() -> Workpiece:
    """A 60 mm cylinder about z; upside down it is the same."""
    return solid(trimesh.creation.cylinder(radius=0.008, height=0.06, sections=32), (180.0, 0.0, 1.0))
