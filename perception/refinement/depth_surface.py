"""A depth image as an organised, normalised surface: position, normal and nearest depth of every pixel.

Normals come from a plane fit in inverse depth, which is linear in pixel coordinates over a plane, so a 5 x 5 window
gives the exact normal of a flat surface with a few separable filters.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from torch import Tensor

from pickproof.cell.sensing.camera import DepthFrame, Intrinsics
from pickproof.perception.ps6d.cloud import ray_slopes

WINDOW = 2
"""Half width of the window of the plane fit in [pixel]."""


@dataclass(frozen=True)
class SurfaceMap:
    """What was measured, in camera coordinates where 1 is `unit` [m].

    Attributes:
        table: (h * w, 8) per pixel: point x, y, z (z = 0 where nothing was measured or outside the region of
            interest), normal towards the camera x, y, z (zero where it could not be fitted), nearest depth in the
            3 x 3 neighbourhood whether of interest or not (0 where nothing was measured), and 0.
        depth: (h * w,) z of the whole image, whether of interest or not, 0 where nothing was measured.
        intrinsics: the pinhole model.
        sigma: standard deviation of a measured depth.
        nearest_vote: (h * w,) index of the voting point nearest in the image; centres: (m, 3) predicted centre of these
            points; both empty before `with_centres`.
    """

    table: Tensor
    depth: Tensor
    intrinsics: Intrinsics
    sigma: float
    nearest_vote: Tensor
    centres: Tensor

    @staticmethod
    def of(frame: DepthFrame, unit: float, sigma: float, roi: np.ndarray | None = None) -> SurfaceMap:
        """Map of a frame; `roi` (h, w) bool limits where workpieces may be; `sigma` in [m]."""
        K = frame.intrinsics
        z = np.nan_to_num(frame.depth / np.float32(unit), nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32)
        z = np.maximum(z, 0.0)
        right, down = (x.astype(np.float32) for x in ray_slopes(K))
        table = np.zeros((K.height, K.width, 8), dtype=np.float32)
        of_interest = z if roi is None else np.where(roi, z, np.float32(0.0))
        table[..., 0], table[..., 1], table[..., 2] = right * of_interest, down * of_interest, of_interest
        table[..., 3:6] = _normals(of_interest, right, down, K)
        far = np.float32(1e6)
        nearest = cv2.erode(np.where(z > 0, z, far), np.ones((3, 3), np.uint8))
        table[..., 6] = np.where(nearest < far, nearest, 0.0)
        of_pixels = torch.from_numpy(table.reshape(-1, 8)), torch.from_numpy(z.reshape(-1))
        return SurfaceMap(*of_pixels, K, sigma / unit, torch.zeros(0, dtype=torch.int32), torch.zeros(0, 3))

    def with_centres(self, points: np.ndarray, centres: np.ndarray) -> SurfaceMap:
        """The map with a predicted centre at every pixel: that of the voting point (m, 3) nearest in the image."""
        K = self.intrinsics
        pixels, _ = self.pixels_of(torch.from_numpy(points.astype(np.float32)))
        free = np.ones(K.height * K.width, np.uint8)
        free[pixels.numpy()] = 0
        _, label = cv2.distanceTransformWithLabels(
            free.reshape(K.height, K.width), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
        )
        flat = label.reshape(-1)
        vote_of_label = np.zeros(int(flat.max()) + 1, np.int32)
        vote_of_label[flat[pixels.numpy()]] = np.arange(len(points))
        nearest = torch.from_numpy(vote_of_label[flat])
        return replace(self, nearest_vote=nearest, centres=torch.from_numpy(centres.astype(np.float32)))

    @functools.cached_property
    def camera(self) -> np.ndarray:
        """fx, fy, cx, cy, width, height (6,) in float32."""
        K = self.intrinsics
        return np.array([K.fx, K.fy, K.cx, K.cy, K.width, K.height], np.float32)

    def pixels_of(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Flat pixel index (...) of camera points (..., 3), and whether they fall into the image."""
        K = self.intrinsics
        z = points[..., 2].clamp(min=1e-3)
        u = (points[..., 0] / z).mul_(K.fx).add_(K.cx).round_()
        v = (points[..., 1] / z).mul_(K.fy).add_(K.cy).round_()
        inside = (u >= 0) & (u <= K.width - 1) & (v >= 0) & (v <= K.height - 1)
        flat = v.clamp_(0, K.height - 1).mul_(K.width).add_(u.clamp_(0, K.width - 1))
        return flat.long(), inside

    def at(self, pixels: Tensor) -> Tensor:
        """Rows (..., 8) of the table."""
        return self.table.index_select(0, pixels.reshape(-1)).reshape(*pixels.shape, 8)


def _normals(z: np.ndarray, right: np.ndarray, down: np.ndarray, K: Intrinsics) -> np.ndarray:
    """Unit normals (h, w, 3) towards the camera; zero where the window holds too little or is not flat."""
    valid = z > 0
    w = valid.astype(np.float32)
    inverse = np.divide(np.float32(1.0), z, out=np.zeros_like(z), where=valid)
    # a constant is subtracted so that float32 sums keep their digits
    middle = np.float32(np.median(inverse[valid])) if valid.any() else np.float32(0.0)
    q = (inverse - middle) * w
    one = np.ones(2 * WINDOW + 1, np.float32)
    ramp = np.arange(-WINDOW, WINDOW + 1, dtype=np.float32)

    def total(image: np.ndarray, along_u: np.ndarray, along_v: np.ndarray) -> np.ndarray:
        return np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, along_u, along_v, borderType=cv2.BORDER_CONSTANT))

    n, nu, nv = total(w, one, one), total(w, ramp, one), total(w, one, ramp)
    nuu, nvv, nuv = total(w, ramp**2, one), total(w, one, ramp**2), total(w, ramp, ramp)
    s, su, sv, ss = total(q, one, one), total(q, ramp, one), total(q, one, ramp), total(q * q, one, one)
    seen = np.flatnonzero(valid)
    n, nu, nv, nuu, nvv, nuv, s, su, sv, ss = (x.reshape(-1)[seen] for x in (n, nu, nv, nuu, nvv, nuv, s, su, sv, ss))
    a, b, c = nuu - nu * nu / n, nuv - nu * nv / n, nvv - nv * nv / n
    e, f, total_variance = su - nu * s / n, sv - nv * s / n, ss - s * s / n
    determinant = a * c - b * b
    fitted = (n >= 8) & (determinant > 1.0)
    safe = np.where(fitted, determinant, np.float32(1.0))
    gu, gv = (c * e - b * f) / safe, (a * f - b * e) / safe
    # of the plane n . ray = d / z: the part along u, v is the slope of inverse depth in ray coordinates
    nx, ny = gu * np.float32(K.fx), gv * np.float32(K.fy)
    row, column = np.divmod(seen, K.width)
    nz = inverse.reshape(-1)[seen] - nx * right[0, column] - ny * down[row, 0]
    # departure from the plane, as depth: dz = z^2 dq
    z = z.reshape(-1)[seen]
    rms = np.sqrt(np.maximum(total_variance - gu * e - gv * f, 0.0) / n) * z * z
    flat = fitted & (rms < np.float32(2.0 / K.fx) * z)
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    scale = np.where(flat, np.float32(-1.0), np.float32(0.0)) / np.maximum(length, np.float32(1e-12))
    normals = np.zeros((*valid.shape, 3), np.float32)
    normals.reshape(-1, 3)[seen] = np.stack([nx * scale, ny * scale, nz * scale], -1)
    return normals
