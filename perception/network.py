"""The PS6D network: attention-guided feature extraction, a centroid head and a quaternion head (PS6D, sec. III).

Set abstraction (PointNet++) and vector attention (Point Transformer, Zhao et al. 2021) over three levels, feature
propagation back to the voting points, N_f = 128. Two additions of ours:

- Local frames. Relative positions enter as F_i^T (p_j - p_i) together with F_i^T F_j, and centre offset and rotation
  are predicted in F_i and turned back: the network is equivariant to rotations of the scene by construction.
- A CAD-coordinate head, trained beside the other two, whose target R^T (p - t) does not change with rotation.

Clouds of a batch are packed into one list of points, so no size has to be equal and nothing is padded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from perception.sampling import VOXELS, Graph


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes of the network.

    Attributes:
        channels: feature channels of levels 1, 2, 3.
        features: N_f of the paper, channels of the shared head feature.
        local_frames: relative geometry in local frames (ours); False gives the plain paper's network.
        cad_head: the auxiliary CAD-coordinate head (ours).
    """

    channels: tuple[int, int, int] = (48, 96, 192)
    features: int = 128
    local_frames: bool = True
    cad_head: bool = True


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
    """Per voting point, in normalised camera axes.

    Attributes:
        centres: (m, 3) predicted centre of the point's workpiece.
        rotations: (m, 3, 3) predicted R_camera_part.
        cad: (m, 3) predicted CAD coordinates in units, or None without that head.
    """

    centres: Tensor
    rotations: Tensor
    cad: Tensor | None


def pack(graphs: list[Graph], device: torch.device | str = "cpu") -> Packed:
    """Concatenate graphs and shift their indices."""

    def cat(arrays: list[np.ndarray]) -> Tensor:
        return torch.from_numpy(np.concatenate(arrays)).to(device, non_blocking=True)

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


def _turn(frames: Tensor, vectors: Tensor) -> Tensor:
    """F^T v element-wise, frames (n, 1, 3, 3) or (n, k, 3, 3) and vectors (n, k, 3); batched matmul is far slower."""
    x, y, z = vectors[..., 0:1], vectors[..., 1:2], vectors[..., 2:3]
    return frames[..., 0, :] * x + frames[..., 1, :] * y + frames[..., 2, :] * z


def relative_geometry(centre: PackedLevel, other: PackedLevel, index: Tensor, scale: float, local: bool) -> Tensor:
    """(n, k, 12): F_i^T (p_j - p_i) / scale and F_i^T F_j; without local frames the plain difference (n, k, 3)."""
    difference = (other.points[index] - centre.points[:, None]) / scale
    if not local:
        return difference
    F = centre.frames[:, None]
    Fj = other.frames[index]
    return torch.cat([_turn(F, difference)] + [_turn(F, Fj[..., axis]) for axis in range(3)], dim=-1)


class Mlp(nn.Module):
    """Linear, BatchNorm over points, ReLU, Linear.

    `norm=False` leaves BatchNorm out: inside the attention, over points times neighbours, it took a third of a step.
    """

    def __init__(self, inside: int, hidden: int, out: int, norm: bool = True) -> None:
        super().__init__()
        self.first, self.second = nn.Linear(inside, hidden), nn.Linear(hidden, out)
        self.norm = nn.BatchNorm1d(hidden) if norm else None

    def forward(self, x: Tensor) -> Tensor:
        y = self.first(x)
        return self.second(torch.relu(self.norm(y) if self.norm is not None else y))


class SetAbstraction(nn.Module):
    """PointNet++ set abstraction: an MLP over each centre's neighbours and a maximum over them."""

    def __init__(self, features: int, geometry: int, out: int) -> None:
        super().__init__()
        self.geometry = nn.Linear(geometry, out)
        self.features = nn.Linear(features, out, bias=False) if features else None
        self.norm, self.second, self.after = nn.BatchNorm1d(out), nn.Linear(out, out), nn.BatchNorm1d(out)

    def forward(self, features: Tensor | None, geometry: Tensor, index: Tensor) -> Tensor:
        x = self.geometry(geometry)
        if self.features is not None and features is not None:
            x = x + self.features(features)[index]
        n, k, c = x.shape
        x = torch.relu(self.norm(x.view(n * k, c)))
        return torch.relu(self.after(self.second(x).view(n, k, c).amax(dim=1)))


class PointTransformerBlock(nn.Module):
    """Vector attention over k neighbours with a residual (Point Transformer, eq. 3)."""

    def __init__(self, c: int, geometry: int) -> None:
        super().__init__()
        self.before = nn.Linear(c, c)
        self.before_norm = nn.BatchNorm1d(c)
        self.q, self.k, self.v = nn.Linear(c, c), nn.Linear(c, c), nn.Linear(c, c)
        self.position = Mlp(geometry, c // 2, c, norm=False)
        self.weights = Mlp(c, c // 4, c // 4, norm=False)
        self.norm, self.after, self.after_norm = nn.BatchNorm1d(c), nn.Linear(c, c), nn.BatchNorm1d(c)

    def forward(self, x: Tensor, geometry: Tensor, index: Tensor) -> Tensor:
        n, k = index.shape
        y = torch.relu(self.before_norm(self.before(x)))
        delta = self.position(geometry)
        attention = torch.softmax(self.weights(self.k(y)[index] - self.q(y)[:, None] + delta), dim=1)
        value = (self.v(y)[index] + delta).view(n, k, 4, -1)  # channels share weights in 4 groups, as published
        y = torch.relu(self.norm((value * attention[:, :, None]).sum(1).view(n, -1)))
        return torch.relu(x + self.after_norm(self.after(y)))


class FeaturePropagation(nn.Module):
    """Features of a coarse level carried to a finer one, seen from the fine points' frames, plus a skip connection."""

    def __init__(self, coarse: int, fine: int, geometry: int, out: int) -> None:
        super().__init__()
        self.coarse, self.geometry = nn.Linear(coarse, out), nn.Linear(geometry, out)
        self.merge = Mlp(out + fine, out, out)
        self.norm = nn.BatchNorm1d(out)

    def forward(self, coarse: Tensor, fine: Tensor, geometry: Tensor, index: Tensor, weights: Tensor) -> Tensor:
        x = torch.relu(self.coarse(coarse)[index] + self.geometry(geometry))
        x = (x * weights[..., None]).sum(1)
        return torch.relu(self.norm(self.merge(torch.cat([x, fine], dim=1))))


class Ps6d(nn.Module):
    """The network; about 0.8 M parameters."""

    def __init__(self, config: NetworkConfig = NetworkConfig()) -> None:
        super().__init__()
        self.config = config
        g = 12 if config.local_frames else 3
        c1, c2, c3 = config.channels
        f = config.features
        self.set1 = SetAbstraction(0, 7 if config.local_frames else 6, c1)
        self.set2, self.set3 = SetAbstraction(c1, g, c2), SetAbstraction(c2, g, c3)
        self.block1, self.block2, self.block3 = (PointTransformerBlock(c, g) for c in (c1, c2, c3))
        self.block3b = PointTransformerBlock(c3, g)
        self.up2, self.up1 = FeaturePropagation(c3, c2, g, c2 + 32), FeaturePropagation(c2 + 32, c1, g, f)
        self.view = nn.Linear(3, f)
        self.shared = Mlp(f, f, f)
        self.centre_head, self.rotation_head = Mlp(f, f, 3), Mlp(f, f, 4)
        self.cad_head = Mlp(f, f, 3) if config.cad_head else None

    def forward(self, cloud: Packed) -> Prediction:
        one, two, three = cloud.levels
        local = self.config.local_frames
        r1, r2, r3 = (2 * voxel for voxel in VOXELS[1:])  # [unit] about the reach of the neighbours of each level
        x1 = self.set1(None, self._input_geometry(cloud, one), one.down)
        x1 = self.block1(x1, relative_geometry(one, one, one.block, r1, local), one.block)
        x2 = self.set2(x1, relative_geometry(two, one, two.down, r1, local), two.down)
        x2 = self.block2(x2, relative_geometry(two, two, two.block, r2, local), two.block)
        x3 = self.set3(x2, relative_geometry(three, two, three.down, r2, local), three.down)
        g3 = relative_geometry(three, three, three.block, r3, local)
        x3 = self.block3b(self.block3(x3, g3, three.block), g3, three.block)
        y2 = self.up2(x3, x2, relative_geometry(two, three, three.up, r3, local), three.up, three.up_weights)
        y1 = self.up1(y2, x1, relative_geometry(one, two, two.up, r2, local), two.up, two.up_weights)
        view = self._voting_view(cloud, one)
        feature = torch.relu(self.shared(y1 + self.view(view)))
        offset, quaternion = self.centre_head(feature), self.rotation_head(feature)
        R = quaternion_to_matrix(quaternion)
        if local:
            F = one.frames
            offset = F[:, :, 0] * offset[:, 0:1] + F[:, :, 1] * offset[:, 1:2] + F[:, :, 2] * offset[:, 2:3]
            R = F @ R
        cad = self.cad_head(feature) if self.cad_head is not None else None
        return Prediction(one.points + offset, R, cad)

    def _input_geometry(self, cloud: Packed, one: PackedLevel) -> Tensor:
        """Geometry of input points around each voting point: position and normal, and with local frames their angle."""
        difference = cloud.points[one.down] - one.points[:, None]
        normals = cloud.normals[one.down]
        if not self.config.local_frames:
            return torch.cat([difference / VOXELS[1], normals], dim=-1)
        F = one.frames[:, None]
        n = _turn(F, normals)
        cosine = (cloud.view[one.down] * normals).sum(-1, keepdim=True)
        return torch.cat([_turn(F, difference) / VOXELS[1], n, cosine], dim=-1)

    def _voting_view(self, cloud: Packed, one: PackedLevel) -> Tensor:
        """Direction to the camera of each voting point in its own frame; it is the view of its nearest input point."""
        view = cloud.view[one.down[:, 0]]
        return _turn(one.frames, view) if self.config.local_frames else view
