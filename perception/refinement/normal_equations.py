"""Gauss-Newton normal equations of many poses, one pass over the points of each.

A residual at a point q in the CAD frame with gradient g has the Jacobian (q x g, g): a turn w and a shift v of the part
move the point by -(w x q + v). Arrays are those of the shape model and the surface map.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from pickproof.perception.refinement.numba_kernels import distance_at, pixel_of, turned, turned_back


@numba.njit(cache=True)
def surface_terms(  # type: ignore[no-untyped-def]
    R, t, view, visible, normals, count, table, camera, threshold, min_facing, projective,
    field, field_origin, field_step, field_shape, nearest_vote, centres, reach, floor, axis, along_factor,
):  # fmt: skip
    """Hessians (h, 6, 6) and slopes (h, 6) of weighted point-to-plane distances.

    Args:
        R, t: (h, 3, 3), (h, 3) poses; view: (h,) index of each pose's visible points.
        visible, normals: (w, p, 3) CAD points and normals of every view, of which the first `count` are used.
        table, camera: of `SurfaceMap`.
        threshold: distance at which Tukey's weight ends; min_facing: least cosine of measured and CAD normal.
        projective: the plane is that of the CAD point, else that of the distance field.
        field, field_origin, field_step, field_shape: `DistanceField.arrays`.
        nearest_vote, centres: of `SurfaceMap`. Where there are centres, a point weighs 1 where the vote nearest to it
            predicted the centre t, and `floor` from about 1.2 `reach` on; the square of an offset along `axis` counts
            1 - `along_factor`.
    """
    hessians, slopes = np.zeros((len(R), 6, 6), np.float32), np.zeros((len(R), 6), np.float32)
    for i in range(len(R)):
        tx, ty, tz = t[i]
        ax, ay, az = turned(R, i, axis[0], axis[1], axis[2])
        for k in range(count):
            px, py, pz = visible[view[i], k]
            x, y, z = turned(R, i, px, py, pz)
            pixel = pixel_of(camera, x + tx, y + ty, z + tz)
            if pixel < 0 or table[pixel, 2] <= 0:
                continue
            qx, qy, qz = turned_back(R, i, table[pixel, 0] - tx, table[pixel, 1] - ty, table[pixel, 2] - tz)
            if projective:
                gx, gy, gz = normals[view[i], k]
                distance = (qx - px) * gx + (qy - py) * gy + (qz - pz) * gz
            else:
                distance, gx, gy, gz = distance_at(field, field_origin, field_step, field_shape, qx, qy, qz)
            weight = _tukey(distance / threshold)
            if weight <= 0:
                continue
            nx, ny, nz = turned_back(R, i, table[pixel, 3], table[pixel, 4], table[pixel, 5])
            if nx * gx + ny * gy + nz * gz <= min_facing:
                continue
            if len(centres):
                ox, oy, oz = centres[nearest_vote[pixel]] - t[i]
                along = ox * ax + oy * ay + oz * az
                square = ox * ox + oy * oy + oz * oz - along_factor * along * along
                weight *= min(max(np.float32(1.5) - square / (reach * reach), floor), np.float32(1.0))
            _add(hessians[i], slopes[i], weight, distance, qx, qy, qz, gx, gy, gz)
        _mirror(hessians[i])
    return hessians, slopes


@numba.njit(cache=True)
def rim_terms(  # type: ignore[no-untyped-def]
    R, t, view, rim, outward, stride, half_width, steps, drop, strength, depth, camera
):
    """Hessians (h, 6, 6) and slopes (h, 6) of the offsets of outline points from edges of the depth image.

    Args:
        R, t, view: as for `surface_terms`.
        rim, outward: (w, q, 3) outline points and outward directions of every view, of which each `stride`-th is used.
        half_width: of the search across the outline, in `steps` steps; drop: least step in depth of an edge.
        strength: weight of all points together.
        depth, camera: of `SurfaceMap`.
    """
    hessians, slopes = np.zeros((len(R), 6, 6), np.float32), np.zeros((len(R), 6), np.float32)
    spacing = np.float32(2.0) * half_width / np.float32(steps - 1)
    used = (rim.shape[1] + stride - 1) // stride
    for i in range(len(R)):
        for k in range(0, rim.shape[1], stride):
            px, py, pz = rim[view[i], k]
            gx, gy, gz = outward[view[i], k]
            x, y, z = turned(R, i, px, py, pz)
            x, y, z = x + t[i, 0], y + t[i, 1], z + t[i, 2]
            dx, dy, dz = turned(R, i, gx, gy, gz)
            edge = _nearest_edge(x, y, z, dx, dy, dz, half_width, steps, drop, depth, camera)
            weight = _tukey(edge / (np.float32(1.2) * half_width)) * strength / used
            if weight > 0:
                # an edge is found to one step of the search; less than that is no reason to move
                offset = np.float32(math.copysign(max(abs(edge) - spacing, np.float32(0.0)), edge))
                _add(hessians[i], slopes[i], weight, offset, px, py, pz, gx, gy, gz)
        _mirror(hessians[i])
    return hessians, slopes


@numba.njit(cache=True)
def _nearest_edge(x, y, z, dx, dy, dz, half_width, steps, drop, depth, camera):  # type: ignore[no-untyped-def]
    """Distance along the direction d from a camera point to the nearest edge of its surface; 1e3 without one."""
    spacing = np.float32(2.0) * half_width / np.float32(steps - 1)
    pixel_size = z / camera[0]
    last_on = last_front = last_behind = -1
    best = np.float32(1e3)
    for step in range(steps):
        along = step * spacing - half_width
        pixel = pixel_of(camera, x + along * dx, y + along * dy, z + along * dz)
        if pixel < 0 or depth[pixel] <= 0:
            continue
        fall = depth[pixel] - z
        if fall > drop:
            if last_on >= 0 and last_on > last_behind and last_on > last_front:
                # pixels at a step go missing on both of its sides, so the edge is in the middle of a narrow gap; a wide
                # one is the projector's shadow, which lies behind the edge
                half_gap = np.float32(0.5) * spacing * (step - last_on)
                inside = half_gap if half_gap < 2 * pixel_size else pixel_size
                position = last_on * spacing - half_width + inside + np.float32(0.25) * pixel_size
                if abs(position) < abs(best):
                    best = np.float32(position)
            last_behind = step
        elif fall < -drop:
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
def _add(H, s, weight, residual, qx, qy, qz, gx, gy, gz):  # type: ignore[no-untyped-def]
    """Add one residual to the upper half of H (6, 6) and to s (6,)."""
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
