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

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array, apply, make_transform
from pickproof.cell.geometry.bin import Box
from pickproof.cell.geometry.raycast import RayCaster, make_caster

DEPTH_SCHEMA = 1
DEPTH_STEP = 2.5e-5
"""[m] one count of the 16-bit PNG: 0.025 mm, range 1.64 m."""
DEPTH_SIGMA = 1.2e-4
"""[m] noise of a depth frame without a stated one: that of the class `structured_light` at 0.85 m."""


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

    def cropped(self, low: np.ndarray, high: np.ndarray, grow: int = 1) -> Intrinsics:
        """Intrinsics of the pixels from `low` up to `high` (2,) as (u, v), each enlarged to `grow` x `grow` pixels."""
        width, height = (int(x) for x in grow * (np.asarray(high) - low))
        # the centre of an enlarged pixel is the centre of its block
        cx, cy = (grow * (c - x) + (grow - 1) / 2 for c, x in zip((self.cx, self.cy), low, strict=True))
        return Intrinsics(width, height, grow * self.fx, grow * self.fy, float(cx), float(cy))

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
        sigma: [m] standard deviation of a measured depth at the working distance, as the camera's data sheet has it.
    """

    depth: np.ndarray
    intrinsics: Intrinsics
    T_world_camera: Array
    sigma: float = DEPTH_SIGMA

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
            "sigma_m": self.sigma,
        }
        path.with_suffix(".json").write_text(json.dumps(meta, indent=1))

    @staticmethod
    def load(path: Path) -> DepthFrame:
        """Read a frame written by `save`.

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
        return DepthFrame(depth, intrinsics, np.asarray(meta["T_world_camera"]), meta.get("sigma_m", DEPTH_SIGMA))


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
        normals: (h, w, 3) float32 unit normals in camera coordinates, on the camera's side; 0 where nothing was hit.
        cos_view: (h, w) cosine between the surface normal and the direction to the camera.
        lit: (h, w) bool: the projector's light reaches the point.
        reflected: (h, w) length in [m] of the camera's ray after a mirror reflection on a workpiece, up to the next
            surface; infinite where there is none; None where not requested.
    """

    depth: Array
    ids: np.ndarray
    normals: np.ndarray
    cos_view: Array
    lit: np.ndarray
    reflected: Array | None = None


@dataclass(frozen=True)
class RenderOptions:
    """Options of the render.

    Attributes:
        projector_offset: the projector's position in camera coordinates [m]; None for no shadow.
        reflections: trace the rays reflected by workpieces (one more cast), see `Render.reflected`.
        threads: of the ray caster.
    """

    projector_offset: tuple[float, float, float] | None = None
    reflections: bool = False
    threads: int = 1


def render(
    part_vertices: Array,
    part_faces: np.ndarray,
    Ts_world_part: Array,
    boxes: Sequence[Box],
    intrinsics: Intrinsics,
    T_world_camera: Array,
    options: RenderOptions | None = None,
) -> Render:
    """Cast one ray a pixel against the exact meshes.

    Args:
        part_vertices, part_faces: the CAD mesh (n, 3) [m] and (m, 3).
        Ts_world_part: (k, 4, 4) poses of the workpieces.
        boxes: static surroundings.
        intrinsics, T_world_camera: of the camera.
        options: shadow of the projector and reflections; None for neither.
    """
    from pickproof.cell.geometry.ray_hits import facing  # numba takes a second to import

    vertices, faces = _scene(part_vertices, part_faces, np.asarray(Ts_world_part), boxes)
    options = options or RenderOptions()
    caster = make_caster(vertices, faces, options.threads)
    shape = (intrinsics.height, intrinsics.width)
    R, eye = T_world_camera[:3, :3], T_world_camera[:3, 3]
    directions = np.ascontiguousarray(intrinsics.rays().reshape(-1, 3) @ R.T)
    hits = caster.cast(eye, directions)
    missed = hits.face < 0
    depth = np.where(missed, 0.0, hits.t)  # directions have z = 1 in the camera, so t is the depth
    ids = np.where(missed, -1, hits.face // max(len(part_faces), 1))
    ids[ids >= len(Ts_world_part)] = -1
    normals, cos_view = facing(vertices, faces, hits.face, directions)
    points = eye + directions * depth[:, None]
    lit = ~missed
    if options.projector_offset is not None:
        # from the light towards the surface: no hit until just before the point
        source = R @ np.asarray(options.projector_offset) + eye
        lit &= caster.cast(source, points - source).t > 1.0 - 1e-3
    reflected = None
    if options.reflections:
        reflected = _reflect(caster, points, directions, normals, ids >= 0).reshape(shape)
    return Render(
        depth.reshape(shape),
        ids.astype(np.int32).reshape(shape),
        (normals @ R).astype(np.float32).reshape(*shape, 3),
        cos_view.reshape(shape),
        lit.reshape(shape),
        reflected,
    )


def _scene(vertices: Array, faces: np.ndarray, Ts: Array, boxes: Sequence[Box]) -> tuple[Array, np.ndarray]:
    """One mesh in the world: the workpieces' faces in order, then those of the boxes."""
    k, n = len(Ts), len(vertices)
    all_vertices = [apply(Ts, vertices).reshape(-1, 3)] if k else []
    all_faces = [(faces[None] + n * np.arange(k)[:, None, None]).reshape(-1, 3)] if k else []
    start = k * n
    for box in boxes:
        solid = trimesh.creation.box(extents=box.size, transform=box.T_world_box)
        all_vertices.append(solid.vertices)
        all_faces.append(solid.faces + start)
        start += len(solid.vertices)
    return np.concatenate(all_vertices), np.concatenate(all_faces)


def _reflect(caster: RayCaster, points: Array, directions: Array, normals: Array, chosen: np.ndarray) -> Array:
    """Lengths (n,) of the reflected rays of the chosen pixels up to the next surface, infinite elsewhere."""
    d, n = directions[chosen], normals[chosen]
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    lengths = np.full(len(points), np.inf)
    lengths[chosen] = caster.cast(points[chosen] + 1e-4 * n, d - 2 * np.einsum("ij,ij->i", d, n)[:, None] * n).t
    return lengths
