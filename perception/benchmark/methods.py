"""The methods of a benchmark: each takes a measured frame and gives poses, scores and the seconds it took.

No method sees the truth, but for the number of visible instances that PPF is told, as in the paper.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.benchmark.ppf import Ppf
from pickproof.perception.estimate import Perception
from pickproof.perception.method import Method as FoundBy
from pickproof.perception.pose_estimate import PoseEstimate
from pickproof.perception.ps6d.cloud import roi_mask, scene_cloud
from pickproof.perception.ps6d.ppr_net import ppr_net, ppr_net_pp
from pickproof.perception.ps6d.variants import variant_of
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.ps6d.weights import load_weights, variant_path, weights_path
from pickproof.perception.refinement.refine import RefineConfig

METHODS = ("ppf", "ppr_net", "ppr_net_pp", "ps6d", "ps6d_fitted", "ps6d_refined", "search", "both")
"""Rows of Table I, in its order, then the search without training and its union with PS6D."""

ABLATIONS = ("ps6d", "pointnet2_msg", "no_normalisation", "single_stage", "no_local_frames", "no_cad_head")
"""Rows of Table II: `single_stage` has the shipped weights, the others weights trained at one budget; each also
refined."""

ABLATION_WORKPIECES = ("ps6d_23", "ps6d_24", "candlestick")
"""Slender, of several symmetries, and a body of revolution (PS6D, sec. IV-E)."""

Kind = Literal["ppf", "ppr_net", "ppr_net_pp", "ps6d", "search", "both"]


@dataclass(frozen=True)
class Found:
    """What a method found in one frame.

    Attributes:
        Ts_camera_part: (p, 4, 4) poses in [m].
        scores: (p,) that rank poses of all frames.
        seconds: processor time of the method alone, which other load on the machine hardly changes.
    """

    Ts_camera_part: Array
    scores: Array
    seconds: float

    @staticmethod
    def of(estimates: list[PoseEstimate], scores: list[float], seconds: float) -> Found:
        """From estimates and what ranks them."""
        return Found(np.array([e.T_camera_part for e in estimates]).reshape(-1, 4, 4), np.array(scores), seconds)


Detector = Callable[[DepthFrame, Bin, int, np.random.Generator], tuple[Found, ...]]
"""Frame, bin, number of visible instances and generator to what was found, one for each row of the method."""


@dataclass(frozen=True)
class Method:
    """A method with its settings for one workpiece.

    Attributes:
        table: I or II of the paper.
        rows: names of its rows; of PS6D the paper's voting, in Table I poses by all votes, and refined.
        weights: of the network; None for PPF and the search.
        variant: what the network must be; None for whatever is shipped.
        frames: how many it sees.
        two_stage: clustering of PS6D.
    """

    table: Literal["methods", "ablations"]
    kind: Kind
    rows: tuple[str, ...]
    weights: Path | None
    variant: str | None
    frames: int
    two_stage: bool = True

    @property
    def calibrated(self) -> bool:
        """Whether the workpiece's own score model goes with the weights: it was fitted to the shipped ones."""
        return self.variant is None

    def train_command(self, workpiece: Workpiece) -> str:
        """The command that makes the weights."""
        variant = f" --variant {self.variant}" if self.variant not in (None, "ps6d") else ""
        return f"pickproof train {workpiece.name}{variant}"

    def check(self, workpiece: Workpiece) -> None:
        """Read the weights.

        Raises:
            InputError: corrupt, of another workpiece or of another variant.
        """
        if self.weights is None:
            return
        found = variant_of(load_weights(self.weights, workpiece).config)
        if self.variant not in (None, found):
            remedy = f"{self.variant}, as `{self.train_command(workpiece)}` writes"
            raise InputError(self.weights, "variant", found, remedy)

    def load(self, workpiece: Workpiece) -> Detector:
        """Ready to detect, in one thread."""
        if self.kind == "ppf":
            cv2.setNumThreads(1)
            return partial(_ppf, Ppf.train(workpiece))
        if self.kind in ("search", "both"):
            method: FoundBy = "search" if self.kind == "search" else "both"
            return partial(_searched, Perception.load(workpiece, self.weights, method=method))
        fit: dict[str, float] | None = {} if self.table == "methods" and self.kind == "ps6d" else None
        config = RefineConfig.model_validate({"cluster": {"two_stage": self.two_stage}, "fit": fit})
        perception = Perception.load(workpiece, self.weights, config, self.calibrated, "ps6d")
        if self.kind == "ps6d":
            return partial(_ps6d, perception)
        return partial(_ppr_net, perception, _published if self.kind == "ppr_net" else _confident)


def methods_of(
    workpiece: Workpiece, frames: int, ppf_frames: int, shipped: Path | None, variants: Path | None
) -> list[Method]:
    """All methods for a workpiece, those of Table II only for its workpieces.

    Args:
        shipped: folder that holds NAME/ps6d.safetensors; None for the shipped weights.
        variants: folder that holds NAME/VARIANT.safetensors; None for the one beside the shipped weights.
    """
    own = weights_path(workpiece) if shipped is None else shipped / workpiece.name / "ps6d.safetensors"

    def trained(variant: str) -> Path:
        beside = variant_path(workpiece, variant)
        return beside if variants is None else variants / workpiece.name / beside.name

    peer = "ppr_net_pp"
    methods = [
        Method("methods", "ppf", ("ppf",), None, None, ppf_frames),
        Method("methods", "ppr_net", ("ppr_net",), trained(peer), peer, frames),
        Method("methods", "ppr_net_pp", ("ppr_net_pp",), trained(peer), peer, frames),
        Method("methods", "ps6d", ("ps6d", "ps6d_fitted", "ps6d_refined"), own, None, frames),
        Method("methods", "search", ("search",), None, None, frames),
        Method("methods", "both", ("both",), own, None, frames),
    ]
    for name in ABLATIONS if workpiece.name in ABLATION_WORKPIECES else ():
        rows = name, f"{name}_refined"
        if name == "single_stage":
            methods.append(Method("ablations", "ps6d", rows, own, None, frames, two_stage=False))
        else:
            methods.append(Method("ablations", "ps6d", rows, trained(name), name, frames))
    return methods


def _ppf(ppf: Ppf, frame: DepthFrame, bin: Bin, true_count: int, rng: np.random.Generator) -> tuple[Found, ...]:
    clock = time.process_time()
    poses = ppf.detect(frame, bin, true_count)
    return (Found.of(poses, [p.n_votes for p in poses], time.process_time() - clock),)


def _ps6d(
    perception: Perception, frame: DepthFrame, bin: Bin, true_count: int, rng: np.random.Generator
) -> tuple[Found, ...]:
    clock = time.process_time()
    result = perception.perceive(frame, bin, rng)
    total = time.process_time() - clock
    stages = result.seconds
    until_raw = sum(stages.get(stage, 0.0) for stage in ("network", "cluster"))
    fit = stages.get("fit", 0.0)
    whole = max(sum(stages.values()), 1e-9)
    rows = [(result.raw, until_raw), (result.fitted, until_raw + fit), (result.estimates, whole - fit)]
    return tuple(Found.of(p, [e.score for e in p], total * part / whole) for p, part in rows if p is not None)


def _searched(
    perception: Perception, frame: DepthFrame, bin: Bin, true_count: int, rng: np.random.Generator
) -> tuple[Found, ...]:
    clock = time.process_time()
    found = perception.perceive(frame, bin, rng).estimates
    return (Found.of(found, [p.score for p in found], time.process_time() - clock),)


def _ppr_net(
    perception: Perception,
    poses_of: Callable[[Votes, float], list[PoseEstimate]],
    frame: DepthFrame,
    bin: Bin,
    true_count: int,
    rng: np.random.Generator,
) -> tuple[Found, ...]:
    clock = time.process_time()
    unit = perception.workpiece.unit
    votes = perception.vote(scene_cloud(frame, roi_mask(frame, bin), unit), rng)
    poses = [] if votes is None else poses_of(votes.finite(), unit)
    return (Found.of(poses, [p.score for p in poses], time.process_time() - clock),)


def _published(votes: Votes, unit: float) -> list[PoseEstimate]:
    return ppr_net(votes, unit)


def _confident(votes: Votes, unit: float) -> list[PoseEstimate]:
    assert votes.confidence is not None  # Method.check
    return ppr_net_pp(votes, votes.confidence, unit)
