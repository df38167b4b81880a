"""The virtual camera: exact ray casting of the CAD at physics poses, and the DepthFrame it hands to perception.

Camera axes follow OpenCV: x right, y down, z forward, so `T_world_camera` maps those coordinates to the world. The
centre of the first pixel is at (u, v) = (0, 0); images are indexed [v, u]. Depth is the z coordinate in [m], not the
length of the ray; 0 marks a missing measurement.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import trimesh

from cell._open3d import load_open3d
from cell.bin import Box
from cell.errors import InputError
from cell.frames import Array, apply, make_transform

DEPTH_SCHEMA = 1
DEPTH_STEP = 2.5e-5
"""[m] one count of the 16-bit PNG: 0.025 mm, range 1.64 m."""


@dataclass(frozen=True)
class Intrinsics:
    """Pinhole camera: focal lengths and principal point in [pixel]."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @staticmethod
    def from_fov(width: int, height: int, fov_x: float) -> Intrinsics:
        """Square pixels and a centred principal point; `fov_x` is the full horizontal angle in [rad]."""
        f = width / 2 / np.tan(fov_x / 2)
        return Intrinsics(width, height, f, f, (width - 1) / 2, (height - 1) / 2)

    def rays(self) -> Array:
        """Ray directions (h, w, 3) in camera coordinates with z = 1, so that depth scales them to points."""
        u, v = np.meshgrid(np.arange(self.width), np.arange(self.height))
        return np.stack([(u - self.cx) / self.fx, (v - self.cy) / self.fy, np.ones_like(u, dtype=float)], -1)

    def project(self, points_camera: Array) -> Array:
        """Pixel coordinates (..., 2) as (u, v) of points (..., 3)."""
        p = np.asarray(points_camera)
        return np.stack([p[..., 0] / p[..., 2] * self.fx + self.cx, p[..., 1] / p[..., 2] * self.fy + self.cy], -1)


@dataclass(frozen=True)
class DepthFrame:
    """What the sensor measured; holds no ground truth.

    Attributes:
        depth: (h, w) float32 in [m] along the camera's z axis; 0 where missing. Read-only.
        intrinsics: the pinhole model.
        T_world_camera: (4, 4) pose of the camera in the world.
    """

    depth: np.ndarray
    intrinsics: Intrinsics
    T_world_camera: Array

    def __post_init__(self) -> None:
        self.depth.flags.writeable = False

    def points_camera(self) -> tuple[Array, np.ndarray]:
        """Measured points (n, 3) in camera coordinates, and their pixel indices (n, 2) as (v, u)."""
        pixels = np.argwhere(self.depth > 0)
        rays = self.intrinsics.rays()[pixels[:, 0], pixels[:, 1]]
        return rays * self.depth[pixels[:, 0], pixels[:, 1], None].astype(np.float64), pixels

    def points_world(self) -> Array:
        """Measured points (n, 3) in world coordinates."""
        return apply(self.T_world_camera, self.points_camera()[0])

    def save(self, path: Path) -> None:
        """Write `path` (.png, 16 bit, DEPTH_STEP a count) and the intrinsics and pose beside it (.json)."""
        counts = np.rint(self.depth / DEPTH_STEP)
        if counts.max(initial=0) > 65535:
            raise InputError(path, "depth", float(self.depth.max()), f"at most {65535 * DEPTH_STEP:.2f} m")
        cv2.imwrite(str(path), counts.astype(np.uint16))
        meta = {
            "schema": DEPTH_SCHEMA,
            "depth_step_m": DEPTH_STEP,
            "intrinsics": vars(self.intrinsics),
            "T_world_camera": self.T_world_camera.tolist(),
        }
        path.with_suffix(".json").write_text(json.dumps(meta, indent=1))

    @staticmethod
    def load(path: Path) -> DepthFrame:
        """Read what `save` wrote.

        Raises:
            InputError: a file is missing or not what `save` writes.
        """
        meta_path = path.with_suffix(".json")
        try:
            meta = json.loads(meta_path.read_text())
        except (OSError, ValueError) as error:
            raise InputError(meta_path, "", str(error), "the JSON written beside a depth PNG") from None
        if meta.get("schema") != DEPTH_SCHEMA:
            raise InputError(meta_path, "schema", meta.get("schema"), str(DEPTH_SCHEMA))
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if image is None or image.dtype != np.uint16 or image.ndim != 2:
            raise InputError(path, "", "unreadable", "a 16-bit one-channel PNG")
        intrinsics = Intrinsics(**meta["intrinsics"])
        if image.shape != (intrinsics.height, intrinsics.width):
            raise InputError(path, "size", image.shape, f"{(intrinsics.height, intrinsics.width)} as in {meta_path}")
        depth = (image.astype(np.float64) * meta["depth_step_m"]).astype(np.float32)
        return DepthFrame(depth, intrinsics, np.asarray(meta["T_world_camera"]))


def look_at(eye: Array, target: Array, up: tuple[float, float, float] = (0.0, 1.0, 0.0)) -> Array:
    """Pose T_world_camera of a camera at `eye` whose z axis points at `target` and whose -y axis is near `up`."""
    z = np.subtract(target, eye)
    z = z / np.linalg.norm(z)
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    return make_transform(np.stack([x, np.cross(z, x), z], axis=1), eye)


@dataclass(frozen=True)
class Render:
    """Exact ray casting before the sensor model; `ids` is ground truth, for scoring and training targets only.

    Attributes:
        depth: (h, w) float64 in [m], 0 where nothing was hit.
        ids: (h, w) int32: index of the workpiece, -1 for anything else.
        cos_view: (h, w) cosine between the surface normal and the direction to the camera.
        lit: (h, w) bool: the projector's light reaches the point.
    """

    depth: Array
    ids: np.ndarray
    cos_view: Array
    lit: np.ndarray


def render(
    part_vertices: Array,
    part_faces: np.ndarray,
    Ts_world_part: Array,
    boxes: Sequence[Box],
    intrinsics: Intrinsics,
    T_world_camera: Array,
    projector_offset: tuple[float, float, float] | None = None,
    threads: int = 1,
) -> Render:
    """Cast one ray a pixel against the exact meshes (Embree through Open3D).

    Args:
        part_vertices, part_faces: the CAD mesh (n, 3) [m] and (m, 3).
        Ts_world_part: (k, 4, 4) poses of the workpieces.
        boxes: static surroundings.
        projector_offset: the projector's position in camera coordinates [m]; None for no shadow.
    """
    o3d = load_open3d()
    scene = o3d.t.geometry.RaycastingScene(nthreads=threads)
    k, n = len(Ts_world_part), len(part_vertices)
    if k:
        vertices = apply(np.asarray(Ts_world_part), part_vertices).reshape(-1, 3)
        faces = (part_faces[None] + n * np.arange(k)[:, None, None]).reshape(-1, 3)
        scene.add_triangles(vertices.astype(np.float32), faces.astype(np.uint32))
    for box in boxes:
        solid = trimesh.creation.box(extents=box.size, transform=box.T_world_box)
        scene.add_triangles(solid.vertices.astype(np.float32), solid.faces.astype(np.uint32))
    rays_camera = intrinsics.rays()
    directions = rays_camera @ T_world_camera[:3, :3].T
    rays = np.empty((intrinsics.height, intrinsics.width, 6), dtype=np.float32)
    rays[..., :3], rays[..., 3:] = T_world_camera[:3, 3], directions
    hit = scene.cast_rays(o3d.core.Tensor(rays), nthreads=threads)
    t = hit["t_hit"].numpy().astype(np.float64)  # directions have z = 1 in the camera, so t is the depth
    missed = ~np.isfinite(t)
    depth = np.where(missed, 0.0, t)
    ids = np.full(depth.shape, -1, dtype=np.int32)
    if k:
        geometry, primitive = hit["geometry_ids"].numpy(), hit["primitive_ids"].numpy()
        of_part = ~missed & (geometry == 0)
        ids[of_part] = primitive[of_part] // len(part_faces)
    normals = hit["primitive_normals"].numpy().astype(np.float64)
    lengths = np.linalg.norm(normals, axis=-1) * np.linalg.norm(directions, axis=-1)
    cos_view = np.abs((normals * directions).sum(-1)) / np.where(lengths > 0, lengths, 1.0)
    lit = ~missed
    if projector_offset is not None:
        points = T_world_camera[:3, 3] + directions * depth[..., None]
        source = T_world_camera[:3, :3] @ np.asarray(projector_offset) + T_world_camera[:3, 3]
        # from the light towards the surface: free until just before the point
        shadow_rays = np.empty_like(rays)
        shadow_rays[..., :3], shadow_rays[..., 3:] = source, points - source
        first = scene.cast_rays(o3d.core.Tensor(shadow_rays), nthreads=threads)["t_hit"].numpy()
        lit &= first > 1.0 - 1e-3
    return Render(depth, ids, cos_view, lit)
