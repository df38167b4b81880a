"""PPR-Net and PPR-Net++: poses from one clustering of the predicted centres.

PPR-Net: Dong et al., IROS 2019. PPR-Net++: Zeng, Lv, Dong, Liu, IEEE T-ASE 2021. As published: mean shift with a flat
kernel on predicted centres alone; votes beyond the bandwidth belong to no instance; an instance's pose is the mean of
its centres and of its rotations, blind to symmetry; PPR-Net has a fixed bandwidth; in PPR-Net++ only points with a
confidence above 0.5 vote. Ours: the bandwidth of PPR-Net++ is a share of the workpiece's unit (the publication fits it
to the spread of the predicted centres), and the score.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from pickproof.cell.frames import make_transform
from pickproof.perception.pose_estimate import PoseEstimate
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.ps6d.voting import evenly, least_votes, mean_shift, nearest_rotations

PPR_NET_BANDWIDTH = 0.010  # [m] of the published evaluation
PPR_NET_PP_BANDWIDTH = 0.12  # [unit] that of stage 1 of PS6D's clustering here
MIN_CONFIDENCE = 0.5
MIN_VOTES = 2.5  # per 1,000 votes; published: 40 of 16,384 points
SEEDS, SAMPLE, ITERATIONS = 512, 1500, 50  # of mean shift, as in ClusterConfig, and until it has converged


def ppr_net(votes: Votes, unit: float) -> list[PoseEstimate]:
    """Poses of PPR-Net, most votes first; `unit` [m] is the votes' unit."""
    return poses_of_centres(votes, unit, PPR_NET_BANDWIDTH / unit, np.ones(len(votes)))


def ppr_net_pp(votes: Votes, confidence: np.ndarray, unit: float) -> list[PoseEstimate]:
    """Poses of PPR-Net++, most votes first.

    Args:
        confidence: (m,) in [0, 1] of each vote: the sigmoid of `Prediction.confidence`.
        unit: [m] of the votes.
    """
    sure = confidence > MIN_CONFIDENCE
    return poses_of_centres(votes.select(sure), unit, PPR_NET_PP_BANDWIDTH, confidence[sure])


def poses_of_centres(votes: Votes, unit: float, bandwidth: float, confidence: np.ndarray) -> list[PoseEstimate]:
    """One pose for each mode of the predicted centres.

    The score is the instance's share of all votes times its mean confidence; residual and visible share are NaN.

    Args:
        bandwidth: [unit] radius of the flat kernel.
        confidence: (m,) in [0, 1].
    """
    if len(votes) == 0:
        return []
    features = votes.centres / bandwidth
    peaks = mean_shift(evenly(features, SAMPLE), SEEDS, ITERATIONS)
    distance, nearest = cKDTree(peaks).query(features)
    groups = [np.flatnonzero((nearest == i) & (distance <= 1.0)) for i in range(len(peaks))]
    groups = [g for g in groups if len(g) >= least_votes(MIN_VOTES, len(votes))]
    return [_pose(votes, unit, g, confidence) for g in sorted(groups, key=len, reverse=True)]


def _pose(votes: Votes, unit: float, members: np.ndarray, confidence: np.ndarray) -> PoseEstimate:
    R = nearest_rotations(votes.rotations[members].sum(axis=0)[None])[0]
    T = make_transform(R, votes.centres[members].mean(axis=0) * unit)
    return PoseEstimate(T, float(confidence[members].sum() / len(votes)), np.nan, np.nan, len(members))
