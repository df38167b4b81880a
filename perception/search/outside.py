"""How much of a pose lies where no workpiece can be: below the floor of the bin or in its walls."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pickproof.cell.frames import invert
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.perception.cad.shape_model import ShapeModel

MARGIN = 0.002
"""[m] that floor and walls may be off."""


def outside(R: Tensor, t: Tensor, shape: ShapeModel, frame: DepthFrame, bin: Bin | None, stride: int = 5) -> np.ndarray:
    """Shares (h,) of the CAD of poses R (h, 3, 3), t (h, 3) outside the bin; zeros where no bin is known.

    Args:
        stride: one in so many of the surface samples is looked at.
    """
    if bin is None:
        return np.zeros(len(R))
    T = invert(bin.T_world_bin) @ frame.T_world_camera
    to_bin = torch.from_numpy(T[:3, :3].astype(np.float32))
    origin = torch.from_numpy((T[:3, 3] / shape.unit).astype(np.float32))
    surface = torch.from_numpy(shape.points[::stride].astype(np.float32))
    points = (surface @ R.transpose(1, 2) + t[:, None]) @ to_bin.T + origin
    margin = MARGIN / shape.unit
    length, width, depth = (edge / shape.unit for edge in bin.inner)
    x, y, z = points.unbind(-1)
    beyond = (x.abs() > length / 2 + margin) | (y.abs() > width / 2 + margin)
    wrong = (z < -margin) | ((z < depth - margin) & beyond)
    return np.asarray(wrong.double().mean(1).numpy())
