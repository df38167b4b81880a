"""Point clouds from files, read by Open3D."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array, from_quat_xyzw
from pickproof.cell.geometry.point_count import check_count, pcd_viewpoint

FORMATS = (".ply", ".pcd", ".xyz", ".xyzn", ".xyzrgb", ".pts")


def read_point_file(path: Path) -> Array:
    """Points (n, 3) of a cloud in the file's own unit and frame; points that are not finite are left out.

    Raises:
        InputError: the file is missing or not readable, or its number of points differs from the declared one.
    """
    from pickproof.cell.geometry._open3d import load_open3d

    valid = f"a point cloud with points ({', '.join(FORMATS)})"
    if not path.is_file():
        raise InputError(path, "", "missing file", valid)
    check_count(path)
    o3d = load_open3d()
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        cloud = o3d.io.read_point_cloud(str(path), remove_nan_points=False, remove_infinite_points=False)
    points = np.asarray(cloud.points, dtype=np.float64)
    points = points[np.isfinite(points).all(1)]
    if not len(points):
        raise InputError(path, "", "no finite points", valid)
    return points


def sensor_pose(path: Path) -> Array | None:
    """T_cloud_sensor (4, 4), lengths in the file's own unit: VIEWPOINT of a PCD file; None where there is none.

    Raises:
        InputError: VIEWPOINT is not a pose.
    """
    values = pcd_viewpoint(path) if path.suffix.lower() == ".pcd" else None
    if values is None:
        return None
    x, y, z, qw, qx, qy, qz = values
    return from_quat_xyzw((x, y, z), (qx, qy, qz, qw))
