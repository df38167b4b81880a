"""Levels, neighbours and local frames of a cloud: everything the network needs that has no parameters.

Levels are nested voxel samples (one random point a voxel), so density, and with it the meaning of k neighbours, is the
same for a full and for a nearly empty bin. All of it is done with kd-trees outside the network.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.ps6d.cloud import Cloud

VOXELS = (0.03, 0.09, 0.19, 0.4)
"""[unit] edge of the voxels of level 0 (input) to 3; level 1 holds the voting points."""
K_SET = 16
"""Neighbours in a set abstraction."""
K_BLOCK = 16
"""Neighbours in a Point Transformer block."""
K_UP = 3
"""Neighbours in a feature propagation."""
NORMAL_NEIGHBOURS = 32
FRAME_NEIGHBOURS = 96
FRAME_RADIUS = 0.22  # [unit]
KDTREE_SINGLE = 4  # FLANN_INDEX_KDTREE_SINGLE of OpenCV, the exact one
MIN_POINTS = 4
"""Levels never get smaller than this many points, so that neighbours exist."""


@dataclass(frozen=True)
class Level:
    """One level: indices into the level below, neighbour indices, and frames.

    Attributes:
        points: (n, 3) in units.
        frames: (n, 3, 3), columns are the x, y, z axes of each point's local frame.
        down: (n, K_SET) neighbours in the level below.
        block: (n, K_BLOCK) neighbours in this level; more in the last one for a slender workpiece.
        up: (n_below, K_UP) neighbours in this level of each point of the level below; empty for level 1.
        up_weights: (n_below, K_UP) inverse-distance weights that sum to 1.
    """

    points: np.ndarray
    frames: np.ndarray
    down: np.ndarray
    block: np.ndarray
    up: np.ndarray
    up_weights: np.ndarray


@dataclass(frozen=True)
class Graph:
    """What the network reads: input points with normals, and three levels.

    Attributes:
        points, normals, view: (n0, 3) float32.
        levels: levels 1, 2 and 3.
        source: (n1,) index into the cloud of each voting point.
    """

    points: np.ndarray
    normals: np.ndarray
    view: np.ndarray
    levels: tuple[Level, Level, Level]
    source: np.ndarray


def voxel_sample(points: Array, voxel: float, rng: np.random.Generator) -> np.ndarray:
    """Indices of one random point of every occupied voxel, in a random grid offset; sorted."""
    if len(points) == 0:
        return np.zeros(0, dtype=np.intp)
    cells = np.floor((points - points.min(axis=0) + rng.uniform(0, voxel, 3)) / voxel).astype(np.int64)
    span = cells.max(axis=0) + 1
    key = (cells[:, 0] * span[1] + cells[:, 1]) * span[2] + cells[:, 2]
    order = rng.permutation(len(points))
    # voxel and place in the random order in one number: sorting numbers is several times faster than sorting indices
    ranked = np.sort(key[order] * len(points) + np.arange(len(points)))
    voxel_of = ranked // len(points)
    first = np.append(True, voxel_of[1:] != voxel_of[:-1])
    return np.sort(order[ranked[first] % len(points)])


class PointTree:
    """A kd-tree over points (n, 3) for exact nearest neighbours; FLANN's takes two thirds of the time of SciPy's."""

    def __init__(self, points: Array) -> None:
        self._points = np.ascontiguousarray(points, dtype=np.float32)
        self._index = cv2.flann.Index(self._points, {"algorithm": KDTREE_SINGLE, "leaf_max_size": 32})

    def nearest(self, queries: Array, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Distances and indices (m, k), nearest first; the last is repeated where fewer than k points exist."""
        k_have = min(k, len(self._points))
        index, square = self._index.knnSearch(np.ascontiguousarray(queries, dtype=np.float32), k_have, params={})
        distance = np.sqrt(square)
        if k_have < k:
            pad = ((0, 0), (0, k - k_have))
            distance, index = np.pad(distance, pad, mode="edge"), np.pad(index, pad, mode="edge")
        return distance, index


def normals_of(points: Array, neighbour: np.ndarray, view: Array) -> Array:
    """Unit normals (n, 3) by PCA of the neighbours (n, k), turned to the camera."""
    offset = [x[neighbour] - x[:, None] for x in points.T]
    sums = [x.sum(1) for x in offset]
    C = np.empty((len(points), 3, 3))
    for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)):
        product = np.einsum("nk,nk->n", offset[i], offset[j]) - sums[i] * sums[j] / neighbour.shape[1]
        C[:, i, j] = C[:, j, i] = product
    normals = least_axis(C)
    return normals * np.where((normals * view).sum(1) < 0, -1.0, 1.0)[:, None]


def least_axis(C: Array) -> Array:
    """Unit eigenvectors (n, 3) of the least eigenvalue of symmetric C (n, 3, 3), in closed form (Smith 1961).

    Five times faster than np.linalg.eigh; where the two lower eigenvalues are equal, any axis of their plane.
    """
    mean = np.trace(C, axis1=1, axis2=2) / 3
    D = C - mean[:, None, None] * np.eye(3)
    p = np.sqrt((D * D).sum((1, 2)) / 6)
    xx, yy, zz, xy, yz, xz = D[:, 0, 0], D[:, 1, 1], D[:, 2, 2], D[:, 0, 1], D[:, 1, 2], D[:, 0, 2]
    determinant = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    angle = np.arccos(np.clip(determinant / np.maximum(2 * p**3, 1e-300), -1.0, 1.0)) / 3
    rows = D - (2 * p * np.cos(angle + 2 * np.pi / 3))[:, None, None] * np.eye(3)
    # the rows are square to the axis; the product of the two that are least parallel has the least error
    crossed = np.cross(rows, np.roll(rows, -1, axis=1))
    length = (crossed * crossed).sum(2)
    best = length.argmax(1)[:, None]
    axis = np.take_along_axis(crossed, best[..., None], 1)[:, 0]
    norm = np.sqrt(np.take_along_axis(length, best, 1))
    return np.where(norm > 0, axis / np.where(norm > 0, norm, 1.0), np.eye(3)[2])


def local_frames(points: Array, normals: Array, queries: np.ndarray, tree: PointTree) -> tuple[Array, np.ndarray]:
    """Local reference frames (n, 3, 3) of points[queries]: z the normal, x the major tangential axis.

    The axis is that of the covariance of the FRAME_NEIGHBOURS nearest points, weighted by max(0, FRAME_RADIUS - d),
    projected to the tangent plane; its sign comes from the third moment (as in SHOT, Tombari 2010, with area weights).
    Also returns these neighbours (n, FRAME_NEIGHBOURS), nearest first.
    """
    distance, index = tree.nearest(points[queries], FRAME_NEIGHBOURS)
    weight = np.maximum(FRAME_RADIUS - distance, 0.0)
    z = normals[queries]
    first = np.cross(z, np.where(np.abs(z[:, :1]) < 0.9, np.eye(3)[0], np.eye(3)[1]))
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(z, first)
    axes = np.stack([first, second], axis=2)
    u, v = np.moveaxis((points[index] - points[queries][:, None]) @ axes, 2, 0)
    total = np.maximum(weight.sum(1), 1e-12)
    wu, wv = weight * u, weight * v
    mean_u, mean_v = wu.sum(1) / total, wv.sum(1) / total
    uu = (wu * u).sum(1) - total * mean_u**2
    vv = (wv * v).sum(1) - total * mean_v**2
    uv = (wu * v).sum(1) - total * mean_u * mean_v
    angle = 0.5 * np.arctan2(2 * uv, uu - vv)  # of the major axis of a 2 x 2 covariance
    c, s = np.cos(angle), np.sin(angle)
    along = c[:, None] * u + s[:, None] * v
    third = (weight * along * along * along).sum(1)
    sign = np.where(third < 0, -1.0, 1.0)
    x = (sign * c)[:, None] * first + (sign * s)[:, None] * second
    return np.stack([x, np.cross(z, x), z], axis=2), index


@dataclass(frozen=True)
class InputPoints:
    """Level 0: a voxel sample of the cloud with normals, shared by all samplings of the levels above.

    Attributes:
        source: (n0,) index into the cloud.
        points, normals, view: (n0, 3) float64.
        tree: over the points.
    """

    source: np.ndarray
    points: Array
    normals: Array
    view: Array
    tree: PointTree


def input_points(cloud: Cloud, rng: np.random.Generator) -> InputPoints | None:
    """Sample level 0; None when the cloud has too few points to hold a workpiece."""
    source = voxel_sample(cloud.points, VOXELS[0], rng)
    if len(source) < 64:
        return None
    points, view = cloud.points[source], cloud.view[source]
    tree = PointTree(points)
    normals = normals_of(points, tree.nearest(points, NORMAL_NEIGHBOURS)[1], view)
    return InputPoints(source, points, normals, view, tree)


def build_graph(cloud: Cloud, rng: np.random.Generator, top: int = K_BLOCK) -> Graph | None:
    """Sample all levels of a cloud; None when it has too few points to hold a workpiece."""
    level0 = input_points(cloud, rng)
    return None if level0 is None else build_levels(level0, rng, top)


def top_neighbours(workpiece: Workpiece) -> int:
    """Neighbours in the blocks of the last level: more for a longer workpiece, so that one end sees the other."""
    return K_BLOCK * workpiece.units_long


def build_levels(level0: InputPoints, rng: np.random.Generator, top: int = K_BLOCK) -> Graph:
    """Sample levels 1 to 3 over the input points, and find all neighbours, `top` of them in the last level."""
    points, normals, tree0 = level0.points, level0.normals, level0.tree
    members = [np.arange(len(points))]
    for voxel in VOXELS[1:]:
        below = members[-1]
        chosen = voxel_sample(points[below], voxel, rng)
        if len(chosen) < MIN_POINTS:
            chosen = np.arange(min(MIN_POINTS, len(below)))
        members.append(below[chosen])
    frames = np.zeros((len(points), 3, 3))
    frames[members[1]], nearest = local_frames(points, normals, members[1], tree0)
    trees = [tree0] + [PointTree(points[m]) for m in members[1:]]
    downs = [nearest[:, :K_SET]] + [trees[i - 1].nearest(points[members[i]], K_SET)[1] for i in (2, 3)]
    levels = [_level(i, points, frames, members, trees[i], downs[i - 1], top if i == 3 else K_BLOCK) for i in (1, 2, 3)]
    return Graph(
        points.astype(np.float32),
        normals.astype(np.float32),
        level0.view.astype(np.float32),
        (levels[0], levels[1], levels[2]),
        level0.source[members[1]],
    )


def _level(
    i: int, points: Array, frames: Array, members: list[np.ndarray], tree: PointTree, down: np.ndarray, k: int
) -> Level:
    here = points[members[i]]
    up, weights = np.zeros((0, K_UP), np.int64), np.zeros((0, K_UP))
    if i > 1:
        distance, up = tree.nearest(points[members[i - 1]], K_UP)
        weights = 1.0 / np.maximum(distance, 1e-3)
        weights /= weights.sum(1, keepdims=True)
    return Level(
        here.astype(np.float32),
        frames[members[i]].astype(np.float32),
        down.astype(np.int64),
        tree.nearest(here, k)[1].astype(np.int64),
        up.astype(np.int64),
        weights.astype(np.float32),
    )
