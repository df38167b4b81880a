"""Point clouds from files, read by Open3D."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cell.errors import InputError
from cell.frames import Array

FORMATS = (".ply", ".pcd", ".xyz", ".xyzn", ".xyzrgb", ".pts")


def read_point_file(path: Path) -> Array:
    """Points (n, 3) of a cloud in the file's own unit and frame; points that are not finite are left out.

    Raises:
        InputError: missing file, or nothing that could be read.
    """
    from cell._open3d import load_open3d

    valid = f"a point cloud with points ({', '.join(FORMATS)})"
    if not path.is_file():
        raise InputError(path, "", "missing file", valid)
    o3d = load_open3d()
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        cloud = o3d.io.read_point_cloud(str(path), remove_nan_points=True, remove_infinite_points=True)
    points = np.asarray(cloud.points, dtype=np.float64)
    if not len(points):
        raise InputError(path, "", "no finite points", valid)
    return points
