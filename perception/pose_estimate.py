"""The pose estimate of one workpiece."""

from __future__ import annotations

from dataclasses import dataclass

from pickproof.cell.frames import Array


@dataclass(frozen=True)
class PoseEstimate:
    """One workpiece found in a depth image.

    Attributes:
        T_camera_part: (4, 4) pose of the CAD frame in the camera frame, lengths in [m].
        score: calibrated probability in [0, 1] that the pose is right.
        visible_share: share of the surface that faces the camera in this pose and was measured there, in [0, 1].
        residual: root mean square distance of the measured surface to the CAD in [m].
        n_votes: voting points that support it.
    """

    T_camera_part: Array
    score: float
    visible_share: float
    residual: float
    n_votes: int

    def __post_init__(self) -> None:
        self.T_camera_part.flags.writeable = False
