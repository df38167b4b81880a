"""Keys of a camera's file that are used, and keys that do not affect the intrinsics.

All other keys with numbers are refused: a lens coefficient, an offset or a scale under an unknown name would change the
meaning of the intrinsics and would be ignored.
"""

from __future__ import annotations

from typing import Any

MATRIX = ("camera_matrix", "cameraMatrix", "cam_K", "K", "k", "mtx", "intrinsic_matrix", "intrinsics", "intrinsic")
FOCAL = ("fx", "fy")
CENTRES = (("cx", "cy"), ("ppx", "ppy"))
WIDTH = ("width", "image_width", "im_width")
HEIGHT = ("height", "image_height", "im_height")
SIZE = ("image_size", "resolution", "im_size")
LENS = (
    *("distortion_coefficients", "distortion_coeffs", "distortion", "dist_coeffs", "distCoeffs", "dist", "coeffs"),
    *("D", "d", "k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2", "s1", "s2", "s3", "s4", "tau_x", "tau_y"),
)
LENS_MODEL = ("distortion_model", "model", "camera_model", "lens_model")
PINHOLE = {
    *("", "none", "pinhole", "perspective", "opencv", "plumb_bob", "radtan", "rational_polynomial"),
    *("brown_conrady", "modified_brown_conrady", "inverse_brown_conrady"),
}
"""Models of a lens that are a pinhole where all coefficients are 0; a fisheye is none."""
REALSENSE_PINHOLE = {0, 1, 2, 4}
"""The same by RealSense's numbers: none, and three kinds of Brown-Conrady."""
SKEW = ("skew", "s")
RECTIFICATION = ("R", "r", "rectification_matrix")
PROJECTION = ("P", "p", "projection_matrix")
ROS = (*RECTIFICATION, *PROJECTION, "binning_x", "binning_y", "roi")
DEPTH = ("depth_scale", "depth_step_m", "sigma_m")
POSE = ("T_world_camera", "cam_R_w2c", "cam_t_w2c", "extrinsic")
FLAGS = ("fisheye_model", "rectified")

UNDERSTOOD = (
    *MATRIX,
    *FOCAL,
    *(name for pair in CENTRES for name in pair),
    *(*WIDTH, *HEIGHT, *SIZE, *LENS, *LENS_MODEL, *SKEW, *ROS, *DEPTH, *POSE, *FLAGS),
)

HARMLESS = {
    *("schema", "version", "version_major", "version_minor", "header", "stamp", "timestamp", "time", "date", "seq"),
    *("id", "camera_id", "sensor_id", "frame_id", "frame", "serial", "serial_number", "device", "name", "camera_name"),
    *("description", "comment", "comments", "fps", "frame_rate", "exposure", "exposure_time", "gain", "temperature"),
    *("baseline", "elev", "mode", "view_level"),  # the last three stand in scene_camera.json of T-LESS
    *("rms", "rms_error", "reprojection_error", "avg_reprojection_error", "mean_reprojection_error"),
    *("per_view_reprojection_errors", "nr_of_frames", "nframes", "calibration_time", "board_width", "board_height"),
    *("square_size", "aspectRatio", "flags", "image_points", "grid_points", "extrinsic_parameters", "class_name"),
}
"""Names, times and what a calibration was made from."""
MEANINGFUL = ("unit", "order", "layout", "convention", "axes", "projection")
"""Parts of names whose texts may change what numbers mean."""


def is_unknown(key: Any, value: Any) -> bool:
    """Whether a key that is not understood may change what the intrinsics mean."""
    if key in HARMLESS or value is None:
        return False
    return any(part in str(key).lower() for part in MEANINGFUL) or holds_numbers(value)


def holds_numbers(value: Any) -> bool:
    """Whether a value is, reads as, or contains a number or a flag."""
    if isinstance(value, dict):
        return any(holds_numbers(entry) for entry in value.values())
    if isinstance(value, (list, tuple)):
        return any(holds_numbers(entry) for entry in value)
    if isinstance(value, str):
        try:
            float(value)
        except ValueError:
            return False
        return True
    return isinstance(value, (bool, int, float))
