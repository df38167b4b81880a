"""Structured-light noise: what turns an exact render into a measured depth image.

Axial noise grows with depth squared (triangulation: dz = z^2 / (f b) dd); lateral quantisation samples each pixel at
a jittered position; pixels at grazing angles, at depth edges and in the projector's shadow go missing.
"""

from __future__ import annotations

import cv2
import numpy as np
from pydantic import Field

from cell.camera import DepthFrame, Intrinsics, Render
from cell.config import Config
from cell.frames import Array


class SensorConfig(Config):
    """Noise of a structured-light camera; `enabled: false` gives the exact render.

    The defaults are of the class of an industrial structured-light camera (repeatability of a point 0.1 mm at 1 m).
    """

    enabled: bool = True
    axial_sigma: float = Field(1.2e-4, ge=0, le=0.01, description="[m] standard deviation at 1 m, grows with z^2")
    axial_floor: float = Field(3e-5, ge=0, le=0.01, description="[m] part that does not depend on depth")
    lateral_sigma: float = Field(0.3, ge=0, le=3, description="[pixel] jitter of the sampled position")
    grazing_deg: float = Field(80.0, gt=30, le=90, description="[deg] incidence beyond which pixels go missing")
    edge_jump: float = Field(0.004, gt=0, description="[m] depth step to a neighbour that counts as an edge")
    edge_dropout: float = Field(0.6, ge=0, le=1, description="probability that an edge pixel is missing")
    speckle_dropout: float = Field(0.01, ge=0, le=1, description="probability that any pixel is missing")
    baseline: float = Field(0.12, ge=0, le=1, description="[m] projector to camera along the camera's x axis")

    @property
    def projector_offset(self) -> tuple[float, float, float] | None:
        return (self.baseline, 0.0, 0.0) if self.enabled and self.baseline > 0 else None


def measure(
    render: Render, intrinsics: Intrinsics, T_world_camera: Array, sensor: SensorConfig, rng: np.random.Generator
) -> DepthFrame:
    """Apply the sensor model to an exact render."""
    if not sensor.enabled:
        return DepthFrame(render.depth.astype(np.float32), intrinsics, T_world_camera)
    h, w = render.depth.shape
    # lateral: the value comes from a jittered position
    jitter = rng.normal(0.0, sensor.lateral_sigma, (2, h, w))
    v, u = np.mgrid[0:h, 0:w]
    vs = np.clip(np.rint(v + jitter[0]), 0, h - 1).astype(np.intp)
    us = np.clip(np.rint(u + jitter[1]), 0, w - 1).astype(np.intp)
    depth = render.depth[vs, us]
    sigma = sensor.axial_floor + sensor.axial_sigma * depth**2
    measured = depth + sigma * rng.standard_normal((h, w))
    # steps to a neighbour, in the exact image: kernel of 3 x 3 maximum and minimum
    exact = render.depth.astype(np.float32)
    kernel = np.ones((3, 3), np.uint8)
    edge = cv2.dilate(exact, kernel) - cv2.erode(exact, kernel) > sensor.edge_jump
    limit = np.cos(np.deg2rad(sensor.grazing_deg))
    # fades out over 10 degrees before the limit
    soft = np.cos(np.deg2rad(max(sensor.grazing_deg - 10.0, 0.0)))
    grazing = rng.random((h, w)) > (render.cos_view - limit) / max(soft - limit, 1e-6)
    missing = (depth <= 0) | ~render.lit | grazing
    missing |= edge & (rng.random((h, w)) < sensor.edge_dropout)
    missing |= rng.random((h, w)) < sensor.speckle_dropout
    return DepthFrame(np.where(missing, 0.0, measured).astype(np.float32), intrinsics, T_world_camera)
