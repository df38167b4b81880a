"""The innermost loop: every seed meets every CAD sample at every turn, millions of poses a frame."""

from __future__ import annotations

import numba
import numpy as np

SCREENS = (6, 14, 32)
"""Points of the CAD after which a pose may be given up, and all that are looked at."""
SECOND_SCREEN = 1.2
"""Factor of the least score at the second screen."""
THROUGH = 0.7
"""What a point counts against a pose where the camera saw through it."""
UNKNOWN_FACING = 0.5
"""Cosine of normals where none was measured."""


@numba.njit(cache=True, fastmath={"contract", "nsz"})
def best_poses(  # type: ignore[no-untyped-def]
    points, frames, samples, sample_frames, seen, view_at, visible, normals, turns, image, camera, least, tolerance,
    R_best, t_best, scores,
):  # fmt: skip
    """Keep the best poses of each seed.

    Args:
        points, frames: (n, 3), (n, 3, 3) of the seeds, the third column of a frame is the normal.
        samples, sample_frames, seen, view_at, turns: of `CadTable`.
        visible, normals: (w, p, 3) of `ShapeModel`.
        image: (h, w, 5) depth, normal x, y, z and nearest depth of each pixel, 0 where unknown.
        camera: fx, fy, cx, cy (4,) of that image.
        least: score below which a pose is given up at a screen; tolerance: in units.
        R_best, t_best, scores: (n, k, 3, 3), (n, k, 3), (n, k), filled from the best down; scores start below all.
    """
    height, width = image.shape[0], image.shape[1]
    cells, keep = view_at.shape[0], scores.shape[1]
    first, second, last = SCREENS
    per_tolerance = np.float32(1.0) / tolerance
    zero, one, half = np.float32(0.0), np.float32(1.0), np.float32(0.5)
    enough_first, enough_second = least * first, SECOND_SCREEN * least * second
    R = np.empty((3, 3), np.float32)
    for i in range(len(points)):
        px, py, pz = points[i]
        far = np.sqrt(px * px + py * py + pz * pz)
        cx, cy, cz = -px / far, -py / far, -pz / far
        # the direction to the camera in the seed's frame: a turn needs no more of it to be given up
        b0 = frames[i, 0, 0] * cx + frames[i, 1, 0] * cy + frames[i, 2, 0] * cz
        b1 = frames[i, 0, 1] * cx + frames[i, 1, 1] * cy + frames[i, 2, 1] * cz
        b2 = frames[i, 0, 2] * cx + frames[i, 1, 2] * cy + frames[i, 2, 2] * cz
        for j in range(len(samples)):
            qx, qy, qz = samples[j, 0], samples[j, 1], samples[j, 2]
            A = sample_frames[j]
            for a in range(len(turns)):
                c, s = turns[a, 0], turns[a, 1]
                d0, d1 = b0 * c + b1 * s, b1 * c - b0 * s
                dx = A[0, 0] * d0 + A[0, 1] * d1 + A[0, 2] * b2
                dy = A[1, 0] * d0 + A[1, 1] * d1 + A[1, 2] * b2
                dz = A[2, 0] * d0 + A[2, 1] * d1 + A[2, 2] * b2
                view = view_at[_cell(dx, dy, dz, cells)]
                if not seen[view, j]:
                    continue
                for x in range(3):
                    t0 = frames[i, x, 0] * c + frames[i, x, 1] * s
                    t1 = frames[i, x, 1] * c - frames[i, x, 0] * s
                    t2 = frames[i, x, 2]
                    for y in range(3):
                        R[x, y] = t0 * A[y, 0] + t1 * A[y, 1] + t2 * A[y, 2]
                tx = px - (R[0, 0] * qx + R[0, 1] * qy + R[0, 2] * qz)
                ty = py - (R[1, 0] * qx + R[1, 1] * qy + R[1, 2] * qz)
                tz = pz - (R[2, 0] * qx + R[2, 1] * qy + R[2, 2] * qz)
                total, refuted = zero, False
                for k in range(last):
                    if (k == first and total < enough_first) or (k == second and total < enough_second):
                        refuted = True
                        break
                    x0, y0, z0 = visible[view, k, 0], visible[view, k, 1], visible[view, k, 2]
                    z = R[2, 0] * x0 + R[2, 1] * y0 + R[2, 2] * z0 + tz
                    per_z = one / z
                    u = int((R[0, 0] * x0 + R[0, 1] * y0 + R[0, 2] * z0 + tx) * per_z * camera[0] + camera[2] + half)
                    v = int((R[1, 0] * x0 + R[1, 1] * y0 + R[1, 2] * z0 + ty) * per_z * camera[1] + camera[3] + half)
                    if u < 0 or v < 0 or u >= width or v >= height:
                        continue
                    nearest, measured = image[v, u, 4], image[v, u, 0]
                    if nearest > 0:
                        through = (nearest - z - tolerance) * per_tolerance
                        if through > 0:
                            total -= np.float32(THROUGH) * min(through, one)
                    if measured > 0:
                        off = (measured - z) * per_tolerance
                        near = one - off * off
                        if near > 0:
                            nx, ny, nz = image[v, u, 1], image[v, u, 2], image[v, u, 3]
                            facing = np.float32(UNKNOWN_FACING)
                            if nz != 0:
                                x1, y1, z1 = normals[view, k, 0], normals[view, k, 1], normals[view, k, 2]
                                facing = (
                                    (R[0, 0] * x1 + R[0, 1] * y1 + R[0, 2] * z1) * nx
                                    + (R[1, 0] * x1 + R[1, 1] * y1 + R[1, 2] * z1) * ny
                                    + (R[2, 0] * x1 + R[2, 1] * y1 + R[2, 2] * z1) * nz
                                )
                                facing = max(facing, zero)
                            total += near * facing
                if refuted:
                    continue
                score = total / last
                if score <= scores[i, keep - 1]:
                    continue
                m = keep - 1
                while m > 0 and scores[i, m - 1] < score:
                    scores[i, m] = scores[i, m - 1]
                    R_best[i, m], t_best[i, m] = R_best[i, m - 1], t_best[i, m - 1]
                    m -= 1
                scores[i, m] = score
                R_best[i, m] = R
                t_best[i, m, 0], t_best[i, m, 1], t_best[i, m, 2] = tx, ty, tz


@numba.njit(cache=True)
def _cell(x, y, z, cells):  # type: ignore[no-untyped-def]
    """Cell of a direction in an octahedral map of that many cells along an edge."""
    length = abs(x) + abs(y) + abs(z)
    ox, oy = x / length, y / length
    if z < 0:
        folded_x = (np.float32(1.0) - abs(oy)) * (np.float32(1.0) if ox >= 0 else np.float32(-1.0))
        folded_y = (np.float32(1.0) - abs(ox)) * (np.float32(1.0) if oy >= 0 else np.float32(-1.0))
        ox, oy = folded_x, folded_y
    half = np.float32(0.5 * cells)
    return min(int((ox + 1) * half), cells - 1), min(int((oy + 1) * half), cells - 1)
