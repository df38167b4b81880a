"""The sensor model: what turns an exact render into the depth image that a camera of some class would measure.

Both classes triangulate, between a projector and the camera or between two cameras, so both have noise that grows with
depth squared, a shadow beside every step, and holes where too little or too much light comes back.
docs/explanation/sensor.md says where the numbers are from.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError
from scipy.special import ndtr

from pickproof.cell.config import Config, Fine, Sigma, metres, read_yaml
from pickproof.cell.frames import Array
from pickproof.cell.sensing.camera import DEPTH_SIGMA, DepthFrame, Intrinsics, Render
from pickproof.cell.workpiece.optics import Optics

PRESETS = Path(__file__).resolve().parent / "cameras"
EDGE_SLOPE = 4.0
"""Largest change of slope (depth per lateral distance) of a crease that does not count as an edge."""
BOUNCE_REACH = 0.03  # [m] path at which reflected light is half as likely to exceed direct light
BOUNCE_LIMIT = 0.05  # [m] error beyond which the camera itself rejects a pixel


def list_presets() -> list[str]:
    """Names of the camera classes."""
    return sorted(path.stem for path in PRESETS.glob("*.yaml"))


@lru_cache(maxsize=8)
def _preset(name: str) -> dict[str, Any]:
    return read_yaml(PRESETS / f"{name}.yaml")


class SensorConfig(Config):
    """Noise of a depth camera; `enabled: false` gives the exact render.

    `preset` names a camera class (cell/sensing/cameras/*.yaml), whose values the other fields replace one by one; the
    defaults below are those of `structured_light`: who changes that file changes them too (a test compares).
    """

    enabled: bool = Field(True, description="false gives the exact render")
    preset: str = Field("structured_light", description="camera class")
    axial_sigma: Sigma = Field(1.2e-4, description="[m] standard deviation at 1 m, grows with z^2")
    axial_floor: Sigma = Field(3e-5, description="[m] part that does not depend on depth")
    correlated_share: float = Field(0.5, ge=0, le=1, description="of the variance that neighbouring pixels share")
    correlation_length: float = Field(2.0, gt=0, le=50, description="[pixel] distance at which that share falls to 1/e")
    lateral_sigma: float = Field(0.3, ge=0, le=3, description="[pixel] jitter of the sampled position")
    grazing_deg: float = Field(80.0, gt=30, le=90, description="[deg] incidence beyond which pixels go missing")
    edge_jump: Fine = Field(0.004, gt=0, description="[m] departure from a plane that counts as an edge")
    edge_width: int = Field(1, ge=1, le=10, description="[pixel] that an edge reaches to either side")
    edge_dropout: float = Field(0.6, ge=0, le=1, description="probability that an edge pixel is missing")
    flying: float = Field(0.1, ge=0, le=1, description="probability that another edge pixel lies between the surfaces")
    speckle_dropout: float = Field(0.01, ge=0, le=1, description="probability that any pixel is missing")
    hole_dropout: float = Field(0.0, ge=0, le=1, description="probability that any pixel lies in a hole")
    patch_length: float = Field(6.0, ge=1, le=50, description="[pixel] size of holes and spots")
    baseline: Annotated[float, metres(1.0)] = Field(
        0.12, ge=0, description="[m] projector or second camera along the camera's x axis"
    )
    min_intensity: float = Field(0.03, ge=0, le=1, description="of a white surface that faces the camera; less is lost")
    max_intensity: float = Field(4.0, gt=0, description="of a white surface that faces the camera; more is saturated")
    interreflection: float = Field(0.3, ge=0, le=1, description="share of mirrored light decoded at a wrong depth")

    @field_validator("preset")
    @classmethod
    def _known(cls, name: str) -> str:
        if name not in list_presets():
            raise PydanticCustomError("preset", f"one of: {', '.join(list_presets())}")
        return name

    @model_validator(mode="before")
    @classmethod
    def _over_the_preset(cls, data: Any) -> Any:
        if isinstance(data, dict) and data.get("preset") in list_presets():
            return {**_preset(data["preset"]), **data}
        return data

    @staticmethod
    def of_preset(name: str) -> SensorConfig:
        """Load a camera class from cell/sensing/cameras/."""
        return SensorConfig.model_validate({"preset": name})

    @property
    def projector_offset(self) -> tuple[float, float, float] | None:
        """Position of the projector in camera coordinates [m]; None where it casts no shadow."""
        return (self.baseline, 0.0, 0.0) if self.enabled and self.baseline > 0 else None

    def sigma_at(self, depth: Any) -> Any:
        """Standard deviation [m] of a depth [m] measured across the view."""
        return self.axial_floor + self.axial_sigma * depth**2

    def sees_reflections(self, optics: Optics) -> bool:
        """Whether `measure` needs `Render.reflected` for a workpiece of these optics."""
        return self.enabled and self.baseline > 0 and self.interreflection > 0 and optics.specular > 0


def random_sensor(rng: np.random.Generator) -> SensorConfig:
    """A random camera for training: 3 of 4 near `structured_light`, 1 of 4 near `stereo`, with a wide range."""
    base = SensorConfig.of_preset("stereo" if rng.random() < 0.25 else "structured_light")
    return SensorConfig.model_validate(
        {
            **base.model_dump(),
            "axial_sigma": base.axial_sigma * rng.uniform(0.3, 2.5),
            "correlated_share": rng.uniform(0.0, 0.9),
            "correlation_length": base.correlation_length * rng.uniform(0.5, 2.0),
            "lateral_sigma": base.lateral_sigma * rng.uniform(0.3, 1.3),
            "grazing_deg": rng.uniform(72, 86),
            "edge_dropout": rng.uniform(0.2, 0.8),
            "flying": base.flying * rng.uniform(0.0, 2.0),
            "speckle_dropout": rng.uniform(0.0, 0.05),
            "hole_dropout": max(rng.uniform(-0.05, 0.05), 0.0),
            "patch_length": base.patch_length * rng.uniform(0.5, 2.0),
            "baseline": base.baseline * rng.uniform(0.35, 1.7),
            "min_intensity": base.min_intensity * np.exp(rng.uniform(-1.0, 1.0)),
            "max_intensity": base.max_intensity * np.exp(rng.uniform(-1.0, 1.0)),
            "interreflection": rng.uniform(0.0, 0.5) if rng.random() < 0.25 else 0.0,
        }
    )


def measure(
    render: Render,
    intrinsics: Intrinsics,
    T_world_camera: Array,
    sensor: SensorConfig,
    rng: np.random.Generator,
    optics: Optics | None = None,
) -> DepthFrame:
    """Apply the sensor model to an exact render.

    Args:
        optics: of the workpieces, matt grey where not given; everything else is matt grey.
    """
    if not sensor.enabled:
        return DepthFrame(render.depth.astype(np.float32), intrinsics, T_world_camera)
    optics = optics or Optics.of("matt_grey")
    exact = render.depth.astype(np.float32)
    depth = _jittered(exact, sensor.lateral_sigma, rng)
    missing = (depth <= 0) | ~render.lit | _grazing(render, sensor, rng)
    edge = depth_edges(exact, intrinsics, sensor)
    depth = _flying(depth, exact, edge, sensor, rng)
    missing |= edge & (_uniform(exact.shape, rng) < sensor.edge_dropout)
    missing |= _uniform(exact.shape, rng) < sensor.speckle_dropout
    if sensor.sees_reflections(optics) and render.reflected is not None:
        depth, rejected = _interreflected(depth, render, intrinsics, sensor, optics, rng)
        missing |= rejected
    seen = _returned(received_intensity(render, intrinsics, sensor.baseline, optics), sensor)
    if sensor.hole_dropout > 0 or (seen < 1).any():
        missing |= ndtr(smooth_noise(exact.shape, sensor.patch_length, rng)) >= seen * (1 - sensor.hole_dropout)
    measured = np.where(missing, np.float32(0.0), depth + sensor.sigma_at(depth) * _noise(exact.shape, sensor, rng))
    return DepthFrame(measured, intrinsics, T_world_camera, _expected_sigma(measured, sensor))


def _expected_sigma(measured: np.ndarray, sensor: SensorConfig) -> float:
    """Standard deviation [m] of the data sheet at the median measured distance."""
    seen = measured[measured > 0]
    return float(sensor.sigma_at(np.median(seen))) if len(seen) else DEPTH_SIGMA


def smooth_noise(shape: tuple[int, ...], length: float, rng: np.random.Generator) -> np.ndarray:
    """Gaussian noise (h, w) float32 of mean 0 and variance 1, correlated by exp(-(r / length)^2) over r in [pixel]."""
    sigma = length / 2  # white noise blurred with sigma has the correlation exp(-r^2 / (4 sigma^2))
    kernel = cv2.getGaussianKernel(2 * int(np.ceil(3 * sigma)) + 1, sigma)
    half = len(kernel) // 2
    white = rng.standard_normal((shape[0] + 2 * half, shape[1] + 2 * half), dtype=np.float32)
    smooth = cv2.sepFilter2D(white, cv2.CV_32F, kernel, kernel)[half : half + shape[0], half : half + shape[1]]
    return np.asarray(smooth / (kernel**2).sum(), dtype=np.float32)


def depth_edges(exact: np.ndarray, intrinsics: Intrinsics, sensor: SensorConfig) -> np.ndarray:
    """(h, w) bool: pixels at a step of the exact depth (h, w) [m], 0 where there is no surface.

    Inverse depth is linear in the pixel over any plane, however steep, so its second difference shows a step (by the
    height of the step) and a crease, but not a slope.
    """
    valid = exact > 0
    inverse = np.divide(1.0, exact, out=np.zeros_like(exact), where=valid)
    padded = cv2.copyMakeBorder(inverse, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    h, w = exact.shape
    bend = np.zeros_like(exact)
    for dv, du in ((0, 1), (1, 0), (1, 1), (1, -1)):
        ahead = padded[1 + dv : 1 + dv + h, 1 + du : 1 + du + w]
        behind = padded[1 - dv : 1 - dv + h, 1 - du : 1 - du + w]
        np.maximum(bend, np.abs(ahead + behind - 2 * inverse), out=bend)
    pixel = exact / np.float32(intrinsics.fx)  # [m]
    edge = valid & (bend * exact**2 > np.maximum(np.float32(sensor.edge_jump), EDGE_SLOPE * pixel))
    if sensor.edge_width > 1:
        edge = cv2.dilate(edge.astype(np.uint8), _window(sensor.edge_width - 1)).astype(bool)
    return edge


def received_intensity(render: Render, intrinsics: Intrinsics, baseline: float, optics: Optics) -> np.ndarray:
    """(h, w) float32 light that comes back, in units of a white Lambertian surface that faces camera and projector.

    Diffuse: albedo cos(i). Specular: the microfacet lobe of Cook and Torrance (1982) with Beckmann's distribution,
    shadowing and Fresnel left out. Both fall with the square of the distance to the projector; the exposure is set for
    the median distance of the image. The projector is at (baseline, 0, 0) in camera coordinates.
    """
    z = render.depth.astype(np.float32)
    x = ((np.arange(intrinsics.width) - intrinsics.cx) / intrinsics.fx).astype(np.float32)[None, :]
    y = ((np.arange(intrinsics.height) - intrinsics.cy) / intrinsics.fy).astype(np.float32)[:, None]
    nx, ny, nz = (render.normals[..., i] for i in range(3))
    lx, ly, lz = np.float32(baseline) - x * z, -y * z, -z
    distance = np.maximum(np.sqrt(lx**2 + ly**2 + lz**2), np.float32(1e-6))
    cos_light = np.maximum((nx * lx + ny * ly + nz * lz) / distance, np.float32(0.0))
    part = render.ids >= 0
    intensity = np.where(part, optics.albedo, Optics.of("matt_grey").albedo).astype(np.float32) * cos_light
    if optics.specular > 0:
        to_camera = np.sqrt(x**2 + y**2 + 1)
        hx, hy, hz = lx / distance - x / to_camera, ly / distance - y / to_camera, lz / distance - 1 / to_camera
        cos_half = (nx * hx + ny * hy + nz * hz) / np.maximum(np.sqrt(hx**2 + hy**2 + hz**2), np.float32(1e-6))
        cos2 = np.maximum(cos_half, np.float32(0.05)) ** 2
        lobe = np.exp((1 - 1 / cos2) / optics.roughness**2) / (4 * optics.roughness**2 * cos2**2)
        intensity += part * (cos_light > 0) * optics.specular * lobe / np.maximum(render.cos_view, 0.05)
    hit = z[::8, ::8] > 0
    usual = np.median(distance[::8, ::8][hit]) if hit.any() else np.float32(1.0)
    return np.asarray(intensity * (usual / distance) ** 2, dtype=np.float32)


def _returned(intensity: np.ndarray, sensor: SensorConfig) -> np.ndarray:
    """Probability (h, w) that a pixel is neither too dark nor saturated: 0.5 at a limit, 1 a factor of 2 inside."""
    dark = np.log2(np.maximum(intensity, np.float32(1e-9)) / max(sensor.min_intensity, 1e-12))
    bright = np.log2(sensor.max_intensity / np.maximum(intensity, np.float32(1e-9)))
    return np.clip(np.float32(0.5) * (1 + np.minimum(dark, bright)), 0.0, 1.0)


def _interreflected(
    depth: np.ndarray,
    render: Render,
    intrinsics: Intrinsics,
    sensor: SensorConfig,
    optics: Optics,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Depth where pixels decode the pattern of the reflected point Q, and which of them the camera rejects.

    The camera triangulates its own ray with the projector's plane through a point between the pixel's and Q's: with
    projector coordinate c = (X - b) / Z, the depth is b / (x - c). Spots are affected, not single pixels.
    """
    assert render.reflected is not None
    spot = ndtr(smooth_noise(depth.shape, sensor.patch_length, rng))
    likely = sensor.interreflection * optics.specular / (1 + (render.reflected / BOUNCE_REACH) ** 2)
    v, u = np.nonzero((spot < likely) & (depth > 0))
    ray = np.stack([(u - intrinsics.cx) / intrinsics.fx, (v - intrinsics.cy) / intrinsics.fy, np.ones(len(u))], -1)
    n = render.normals[v, u].astype(np.float64)
    unit = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    mirrored = unit - 2 * np.einsum("ij,ij->i", unit, n)[:, None] * n
    z = depth[v, u].astype(np.float64)
    q = ray * z[:, None] + mirrored * render.reflected[v, u, None]
    own, other = ray[:, 0] - sensor.baseline / z, (q[:, 0] - sensor.baseline) / np.maximum(q[:, 2], 1e-3)
    mix = spot[v, u] / likely[v, u]  # uniform over the hit pixels and smooth inside a spot
    disparity = ray[:, 0] - ((1 - mix) * own + mix * other)
    wrong = sensor.baseline / np.maximum(disparity, 1e-6)
    result, rejected = depth.copy(), np.zeros(depth.shape, dtype=bool)
    result[v, u] = wrong
    rejected[v, u] = np.abs(wrong - z) > BOUNCE_LIMIT
    return result, rejected


def _jittered(exact: np.ndarray, sigma: float, rng: np.random.Generator) -> np.ndarray:
    """Give each pixel the depth of a random position near it."""
    if sigma == 0:
        return exact
    h, w = exact.shape
    jitter = np.rint(sigma * rng.standard_normal((2, h, w), dtype=np.float32)).astype(np.intp)
    v = np.clip(np.arange(h)[:, None] + jitter[0], 0, h - 1)
    u = np.clip(np.arange(w)[None, :] + jitter[1], 0, w - 1)
    return exact[v, u]


def _grazing(render: Render, sensor: SensorConfig, rng: np.random.Generator) -> np.ndarray:
    """Missing at grazing incidence: begins 10 degrees before the limit, complete at it."""
    limit, soft = np.cos(np.deg2rad([sensor.grazing_deg, sensor.grazing_deg - 10.0]))
    return np.asarray(_uniform(render.depth.shape, rng) > (render.cos_view - limit) / (soft - limit))


def _flying(
    depth: np.ndarray, exact: np.ndarray, edge: np.ndarray, sensor: SensorConfig, rng: np.random.Generator
) -> np.ndarray:
    """Some edge pixels get a depth between the nearest and the farthest surface in their window."""
    v, u = np.nonzero(edge & (_uniform(exact.shape, rng) < sensor.flying))
    if not len(v):
        return depth
    window = _window(sensor.edge_width)
    far = cv2.dilate(exact, window)[v, u]
    near = cv2.erode(np.where(exact > 0, exact, np.float32(np.inf)), window)[v, u]
    mixed = depth.copy()
    mixed[v, u] = near + (far - near) * rng.random(len(v), dtype=np.float32)
    return mixed


def _noise(shape: tuple[int, ...], sensor: SensorConfig, rng: np.random.Generator) -> np.ndarray:
    """Axial noise (h, w) of variance 1: an independent part per pixel, and a part shared by neighbours."""
    white = rng.standard_normal(shape, dtype=np.float32)
    if sensor.correlated_share == 0:
        return white
    shared = smooth_noise(shape, sensor.correlation_length, rng)
    share = np.float32(sensor.correlated_share)
    return np.asarray(np.sqrt(1 - share) * white + np.sqrt(share) * shared)


def _uniform(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    return rng.random(shape, dtype=np.float32)


def _window(reach: int) -> np.ndarray:
    return np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
