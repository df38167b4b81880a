"""The PS6D network: attention-guided feature extraction, a centroid head and a quaternion head (PS6D, sec. III).

Set abstraction (PointNet++) and vector attention (Point Transformer, Zhao et al. 2021) over three levels, feature
propagation back to the voting points, N_f = 128. Two additions of ours:

- Local frames. Relative positions enter as F_i^T (p_j - p_i) together with F_i^T F_j, and centre offset and rotation
  are predicted in F_i and turned back: the network is equivariant to rotations of the scene by construction.
- A CAD-coordinate head, trained beside the other two, whose target R^T (p - t) does not change with rotation.

The peers and ablations of the paper's tables are configurations of this network; `variants.py` names them.

Clouds of a batch are packed into one list of points, so no size has to be equal and nothing is padded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from torch import Tensor, nn

from pickproof.perception.ps6d.layers import (
    FeaturePropagation,
    Mlp,
    MultiScaleGrouping,
    PointTransformerBlock,
    SetAbstraction,
    gather,
    turn,
)
from pickproof.perception.ps6d.point_hierarchy import VOXELS, Graph


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes and parts of the network.

    Attributes:
        channels: feature channels of levels 1, 2, 3 (of each scale with multi-scale grouping).
        features: N_f of the paper, channels of the shared head feature.
        local_frames: relative geometry in local frames (ours); False gives the plain paper's network.
        cad_head: the auxiliary CAD-coordinate head (ours).
        backbone: Point Transformer blocks (PS6D), or PointNet++ with multi-scale grouping in their place.
        heads: centre and quaternion (PS6D), or centre, Euler angles and confidence (PPR-Net++).
        coordinate_scale: lengths of 0.1 m in one unit of the cloud, in which coordinates then enter and leave the
            network whatever the workpiece's size; None for the normalised workpiece space.
    """

    channels: tuple[int, int, int] = (48, 96, 192)
    features: int = 128
    local_frames: bool = True
    cad_head: bool = True
    backbone: Literal["point_transformer", "pointnet2_msg"] = "point_transformer"
    heads: Literal["ps6d", "ppr_net"] = "ps6d"
    coordinate_scale: float | None = None

    def __post_init__(self) -> None:
        if self.backbone not in ("point_transformer", "pointnet2_msg") or self.heads not in ("ps6d", "ppr_net"):
            raise ValueError(f"no backbone {self.backbone} or no heads {self.heads}")

    @property
    def scale(self) -> float:
        """The network's units of length in one unit of the cloud."""
        return 1.0 if self.coordinate_scale is None else self.coordinate_scale


@dataclass(frozen=True)
class PackedLevel:
    """A Level of several clouds, indices shifted to the packed list."""

    points: Tensor
    frames: Tensor
    down: Tensor
    block: Tensor
    up: Tensor
    up_weights: Tensor


@dataclass(frozen=True)
class Packed:
    """Graphs of a batch in one list; `sizes` are the voting points of each cloud."""

    points: Tensor
    normals: Tensor
    view: Tensor
    levels: tuple[PackedLevel, ...]
    sizes: tuple[int, ...]


@dataclass(frozen=True)
class Prediction:
    """Per voting point, in camera axes and units of the cloud.

    Attributes:
        centres: (m, 3) predicted centre of the point's workpiece.
        rotations: (m, 3, 3) predicted R_camera_part.
        cad: (m, 3) predicted CAD coordinates, or None without that head.
        confidence: (m,) log odds that the point's pose is right, or None without that head.
    """

    centres: Tensor
    rotations: Tensor
    cad: Tensor | None
    confidence: Tensor | None = None


def pack(graphs: list[Graph], device: torch.device | str = "cpu") -> Packed:
    """Concatenate graphs and shift their indices."""

    on_cuda = torch.device(device).type == "cuda"

    def cat(arrays: list[np.ndarray]) -> Tensor:
        packed = torch.from_numpy(np.concatenate(arrays))
        return packed.pin_memory().to(device, non_blocking=True) if on_cuda else packed

    counts0 = [len(g.points) for g in graphs]
    levels = []
    below = counts0
    for i in range(3):
        ls = [g.levels[i] for g in graphs]
        here = [len(level.points) for level in ls]
        start_below, start = np.cumsum([0, *below]), np.cumsum([0, *here])
        levels.append(
            PackedLevel(
                cat([level.points for level in ls]),
                cat([level.frames for level in ls]),
                cat([level.down + s for level, s in zip(ls, start_below, strict=False)]),
                cat([level.block + s for level, s in zip(ls, start, strict=False)]),
                cat([level.up + s for level, s in zip(ls, start, strict=False)]),
                cat([level.up_weights for level in ls]),
            )
        )
        below = here
    return Packed(
        cat([g.points for g in graphs]),
        cat([g.normals for g in graphs]),
        cat([g.view for g in graphs]),
        tuple(levels),
        tuple(len(g.levels[0].points) for g in graphs),
    )


def quaternion_to_matrix(quat_xyzw: Tensor) -> Tensor:
    """Rotation matrices (m, 3, 3) of quaternions (m, 4), normalised here."""
    x, y, z, w = (quat_xyzw / quat_xyzw.norm(dim=1, keepdim=True).clamp_min(1e-8)).unbind(1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
        2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
        2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, dim=1).view(-1, 3, 3)


def euler_to_matrix(rpy: Tensor) -> Tensor:
    """Rotation matrices (m, 3, 3) = Rz(yaw) Ry(pitch) Rx(roll) of angles (m, 3) [rad] about fixed axes."""
    cr, cp, cy = rpy.cos().unbind(1)
    sr, sp, sy = rpy.sin().unbind(1)
    rows = [
        cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr,
        sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr,
        -sp, cp * sr, cp * cr,
    ]  # fmt: skip
    return torch.stack(rows, dim=1).view(-1, 3, 3)


def relative_geometry(centre: PackedLevel, other: PackedLevel, index: Tensor, scale: float, local: bool) -> Tensor:
    """(n, k, 12): F_i^T (p_j - p_i) / scale and F_i^T F_j; without local frames the plain difference (n, k, 3)."""
    if not local:
        return (gather(other.points, index) - centre.points[:, None]) / scale
    axes = other.frames.transpose(1, 2).flatten(1)
    vectors = gather(torch.cat([other.points, axes], dim=1), index)
    vectors[..., :3] -= centre.points[:, None]
    vectors[..., :3] /= scale
    return turn(vectors, centre.frames)


class Ps6d(nn.Module):
    """The network; about 0.8 M parameters."""

    def __init__(self, config: NetworkConfig = NetworkConfig()) -> None:
        super().__init__()
        self.config = config
        local = config.local_frames
        g, g1 = (12, 7) if local else (3, 6)
        c1, c2, c3 = config.channels
        f = config.features
        if config.backbone == "point_transformer":
            sets: list[nn.Module] = [SetAbstraction(*c) for c in ((0, g1, c1), (c1, g, c2), (c2, g, c3))]
            self.block1, self.block2, self.block3 = (PointTransformerBlock(c, g) for c in (c1, c2, c3))
            self.block3b = PointTransformerBlock(c3, g)
        else:
            sets = [MultiScaleGrouping(*c) for c in ((0, g1, c1), (2 * c1, g, c2), (2 * c2, g, c3))]
            c1, c2, c3 = 2 * c1, 2 * c2, 2 * c3
        self.set1, self.set2, self.set3 = sets
        self.up2, self.up1 = FeaturePropagation(c3, c2, g, c2 + 32), FeaturePropagation(c2 + 32, c1, g, f)
        self.view = nn.Linear(3, f)
        self.shared = Mlp(f, f, f)
        ppr = config.heads == "ppr_net"
        self.centre_head, self.rotation_head = Mlp(f, f, 3), Mlp(f, f, 3 if ppr else 4)
        self.cad_head = Mlp(f, f, 3) if config.cad_head else None
        self.confidence_head = Mlp(f + 6, 64, 1) if ppr else None

    def forward(self, cloud: Packed) -> Prediction:
        """One vote for every voting point of the packed clouds."""
        one, two, three = cloud.levels
        transformer = self.config.backbone == "point_transformer"
        x1, x2, x3 = self._point_transformer(cloud) if transformer else self._multi_scale(cloud)
        y2 = self.up2(x3, x2, self._relative(two, three, three.up, 3), three.up, three.up_weights)
        y1 = self.up1(y2, x1, self._relative(one, two, two.up, 2), two.up, two.up_weights)
        feature = torch.relu_(self.shared(y1 + self.view(self._voting_view(cloud, one))))
        offset, rotation = self.centre_head(feature), self.rotation_head(feature)
        R = euler_to_matrix(rotation) if self.config.heads == "ppr_net" else quaternion_to_matrix(rotation)
        confidence = self._confidence(feature, offset, rotation)
        if self.config.local_frames:
            offset = torch.bmm(one.frames, offset[:, :, None])[:, :, 0]
            R = one.frames @ R
        scale = self.config.scale
        cad = self.cad_head(feature) / scale if self.cad_head is not None else None
        return Prediction(one.points + offset / scale, R, cad, confidence)

    def _point_transformer(self, cloud: Packed) -> tuple[Tensor, Tensor, Tensor]:
        """Features of the three levels: set abstraction, then attention among the level's own points."""
        one, two, three = cloud.levels
        x1 = self.set1(None, self._input_geometry(cloud, one.down), one.down)
        x1 = self.block1(x1, self._relative(one, one, one.block, 1), one.block)
        x2 = self.set2(x1, self._relative(two, one, two.down, 1), two.down)
        x2 = self.block2(x2, self._relative(two, two, two.block, 2), two.block)
        x3 = self.set3(x2, self._relative(three, two, three.down, 2), three.down)
        g3 = self._relative(three, three, three.block, 3)
        return x1, x2, self.block3b(self.block3(x3, g3, three.block), g3, three.block)

    def _multi_scale(self, cloud: Packed) -> tuple[Tensor, Tensor, Tensor]:
        """Features of the three levels by grouping at two scales.

        The near group are the nearest points of the level below; the far one, about three times as wide, those of the
        level itself, which levels being nested are points of the level below too.
        """
        one, two, three = cloud.levels
        near, far = one.down, gather(one.down[:, :1], one.block)[..., 0]
        geometries = self._input_geometry(cloud, near), self._input_geometry(cloud, far)
        x1 = self.set1(None, geometries, (near, far))
        near, far = two.down, gather(two.down[:, :1], two.block)[..., 0]
        x2 = self.set2(x1, (self._relative(two, one, near, 1), self._relative(two, one, far, 2)), (near, far))
        near, far = three.down, gather(three.down[:, :1], three.block)[..., 0]
        x3 = self.set3(x2, (self._relative(three, two, near, 2), self._relative(three, two, far, 3)), (near, far))
        return x1, x2, x3

    def _relative(self, centre: PackedLevel, other: PackedLevel, index: Tensor, level: int) -> Tensor:
        """Relative geometry scaled by the reach of the neighbours of a level, about two voxels."""
        scale = 2 * VOXELS[level] / self.config.scale
        return relative_geometry(centre, other, index, scale, self.config.local_frames)

    def _input_geometry(self, cloud: Packed, index: Tensor) -> Tensor:
        """Geometry of input points around each voting point: position and normal, and with local frames their angle."""
        one = cloud.levels[0]
        vectors = gather(torch.cat([cloud.points, cloud.normals], dim=1), index)
        vectors[..., :3] -= one.points[:, None]
        vectors[..., :3] /= VOXELS[1] / self.config.scale
        if not self.config.local_frames:
            return vectors
        cosine = (cloud.view * cloud.normals).sum(-1, keepdim=True)
        return torch.cat([turn(vectors, one.frames), gather(cosine, index)], dim=-1)

    def _voting_view(self, cloud: Packed, one: PackedLevel) -> Tensor:
        """Direction to the camera of each voting point in its own frame; it is the view of its nearest input point."""
        view = cloud.view[one.down[:, 0]]
        return turn(view[:, None], one.frames)[:, 0] if self.config.local_frames else view

    def _confidence(self, feature: Tensor, offset: Tensor, rotation: Tensor) -> Tensor | None:
        """From the feature and, without gradient, the predicted offset and angles (PPR-Net++)."""
        if self.confidence_head is None:
            return None
        return self.confidence_head(torch.cat([feature, offset.detach(), rotation.detach()], dim=1))[:, 0]
