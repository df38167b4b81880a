"""Gauss-Newton normal equations of many poses, one pass over the points of each.

A residual at a point q in the CAD frame with gradient g has the Jacobian (q x g, g): a turn w and a shift v of the part
move the point by -(w x q + v). Arrays are those of the shape model and the surface map; named tuples carry
them into the compiled loops.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from pickproof.perception.refinement.numba_kernels import distance_at, pixel_of, turned, turned_back


class CadPoints(NamedTuple):
    """Visible points and outward normals (w, p, 3) of every view, of which the first `used` take part."""

    points: np.ndarray
    normals: np.ndarray
    used: int


class Association(NamedTuple):
    """Which measured point belongs to a pose.

    Fields:
        threshold: distance at which Tukey's weight ends; min_facing: least cosine of measured and CAD normal.
        projective: the plane is that of the CAD point, else that of the distance field.
    """

    threshold: np.float32
    min_facing: np.float32
    projective: bool


class VoteWeights(NamedTuple):
    """How the vote nearest to a measured point weighs it.

    Fields:
        nearest_vote, centres: of `SurfaceMap`; without centres every point weighs 1.
        reach, floor: a point weighs 1 where the vote predicted the centre of the pose, and `floor` from about 1.2
            `reach` on.
        axis, along_factor: the square of an offset along `axis` counts 1 - `along_factor`.
    """

    nearest_vote: np.ndarray
    centres: np.ndarray
    reach: np.float32
    floor: np.float32
    axis: np.ndarray
    along_factor: np.float32


class Outline(NamedTuple):
    """Outline points and outward directions (w, q, 3) of every view, of which each `stride`-th is used."""

    points: np.ndarray
    outward: np.ndarray
    stride: int


class EdgeSearch(NamedTuple):
    """Search for edges of the depth image across the outline.

    Fields:
        half_width: of the search, in `steps` steps; drop: least step in depth of an edge.
        strength: weight of all points together.
        depth, camera: of `SurfaceMap`.
    """

    half_width: np.float32
    steps: int
    drop: np.float32
    strength: np.float32
    depth: np.ndarray
    camera: np.ndarray


@numba.njit(cache=True)
def surface_terms(poses, cad, table, camera, field, rule, votes):  # type: ignore[no-untyped-def]
    """Hessians (h, 6, 6) and slopes (h, 6) of weighted point-to-plane distances.

    Args:
        poses: `KernelPoses`; cad: `CadPoints`; rule: `Association`; votes: `VoteWeights`.
        table, camera: of `SurfaceMap`. field: `FieldArrays`.
    """
    R, t, view = poses
    visible, normals, used = cad
    axis, centres = votes.axis, votes.centres
    hessians, slopes = np.zeros((len(R), 6, 6), np.float32), np.zeros((len(R), 6), np.float32)
    for i in range(len(R)):
        tx, ty, tz = t[i]
        ax, ay, az = turned(R, i, axis[0], axis[1], axis[2])
        for k in range(used):
            px, py, pz = visible[view[i], k]
            x, y, z = turned(R, i, px, py, pz)
            pixel = pixel_of(camera, x + tx, y + ty, z + tz)
            if pixel < 0 or table[pixel, 2] <= 0:
                continue
            qx, qy, qz = turned_back(R, i, table[pixel, 0] - tx, table[pixel, 1] - ty, table[pixel, 2] - tz)
            if rule.projective:
                gx, gy, gz = normals[view[i], k]
                distance = (qx - px) * gx + (qy - py) * gy + (qz - pz) * gz
            else:
                distance, gx, gy, gz = distance_at(field.table, field.origin, field.step, field.shape, qx, qy, qz)
            weight = _tukey(distance / rule.threshold)
            if weight <= 0:
                continue
            nx, ny, nz = turned_back(R, i, table[pixel, 3], table[pixel, 4], table[pixel, 5])
            if nx * gx + ny * gy + nz * gz <= rule.min_facing:
                continue
            if len(centres):
                ox, oy, oz = centres[votes.nearest_vote[pixel]] - t[i]
                along = ox * ax + oy * ay + oz * az
                square = ox * ox + oy * oy + oz * oz - votes.along_factor * along * along
                near = np.float32(1.5) - square / (votes.reach * votes.reach)
                weight *= min(max(near, votes.floor), np.float32(1.0))
            _add(hessians[i], slopes[i], weight, distance, (qx, qy, qz), (gx, gy, gz))
        _mirror(hessians[i])
    return hessians, slopes


@numba.njit(cache=True)
def rim_terms(poses, outline, search):  # type: ignore[no-untyped-def]
    """Hessians (h, 6, 6) and slopes (h, 6) of the offsets of outline points from edges of the depth image.

    Args:
        poses: `KernelPoses`; outline: `Outline`; search: `EdgeSearch`.
    """
    R, t, view = poses
    rim, outward, stride = outline
    hessians, slopes = np.zeros((len(R), 6, 6), np.float32), np.zeros((len(R), 6), np.float32)
    spacing = np.float32(2.0) * search.half_width / np.float32(search.steps - 1)
    used = (rim.shape[1] + stride - 1) // stride
    for i in range(len(R)):
        for k in range(0, rim.shape[1], stride):
            px, py, pz = rim[view[i], k]
            gx, gy, gz = outward[view[i], k]
            x, y, z = turned(R, i, px, py, pz)
            point = (x + t[i, 0], y + t[i, 1], z + t[i, 2])
            edge = _nearest_edge(point, turned(R, i, gx, gy, gz), search)
            weight = _tukey(edge / (np.float32(1.2) * search.half_width)) * search.strength / used
            if weight > 0:
                # an edge is found to one step of the search; less than that is no reason to move
                offset = np.float32(math.copysign(max(abs(edge) - spacing, np.float32(0.0)), edge))
                _add(hessians[i], slopes[i], weight, offset, (px, py, pz), (gx, gy, gz))
        _mirror(hessians[i])
    return hessians, slopes


@numba.njit(cache=True)
def _nearest_edge(point, direction, search):  # type: ignore[no-untyped-def]
    """Distance along a direction from a camera point to the nearest edge of its surface; 1e3 without one."""
    x, y, z = point
    dx, dy, dz = direction
    spacing = np.float32(2.0) * search.half_width / np.float32(search.steps - 1)
    pixel_size = z / search.camera[0]
    last_on = last_front = last_behind = -1
    best = np.float32(1e3)
    for step in range(search.steps):
        along = step * spacing - search.half_width
        pixel = pixel_of(search.camera, x + along * dx, y + along * dy, z + along * dz)
        if pixel < 0 or search.depth[pixel] <= 0:
            continue
        fall = search.depth[pixel] - z
        if fall > search.drop:
            if last_on >= 0 and last_on > last_behind and last_on > last_front:
                # pixels at a step go missing on both of its sides, so the edge is in the middle of a narrow gap; a wide
                # one is the projector's shadow, which lies behind the edge
                half_gap = np.float32(0.5) * spacing * (step - last_on)
                inside = half_gap if half_gap < 2 * pixel_size else pixel_size
                position = last_on * spacing - search.half_width + inside + np.float32(0.25) * pixel_size
                if abs(position) < abs(best):
                    best = np.float32(position)
            last_behind = step
        elif fall < -search.drop:
            last_front = step
        else:
            last_on = step
    return best


@numba.njit(cache=True)
def _tukey(ratio):  # type: ignore[no-untyped-def]
    """Tukey's biweight of a residual over its limit."""
    weight = np.float32(1.0) - ratio * ratio
    return weight * weight if weight > 0 else np.float32(0.0)


@numba.njit(cache=True)
def _add(H, s, weight, residual, point, gradient):  # type: ignore[no-untyped-def]
    """Add one residual to the upper half of H (6, 6) and to s (6,)."""
    qx, qy, qz = point
    gx, gy, gz = gradient
    J = (qy * gz - qz * gy, qz * gx - qx * gz, qx * gy - qy * gx, gx, gy, gz)
    for m in range(6):
        wj = weight * J[m]
        s[m] += wj * residual
        for n in range(m, 6):
            H[m, n] += wj * J[n]


@numba.njit(cache=True)
def _mirror(H):  # type: ignore[no-untyped-def]
    for m in range(6):
        for n in range(m):
            H[m, n] = H[n, m]
