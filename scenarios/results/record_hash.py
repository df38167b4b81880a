"""The record hash: equal for the same picks on every machine; docs/explanation/determinism.md."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord


def record_hash(attempts: Sequence[AttemptRecord], episodes: Sequence[EpisodeRecord]) -> str:
    """SHA-256 over attempts, outcomes and poses in order of seed and attempt.

    Floats enter by their exact bits (`float.hex`; poses after the attempt as little-endian IEEE 754); times, pictures
    and everything about the machine stay out.
    """
    digest = hashlib.sha256()
    for a in sorted(attempts, key=lambda a: (a.seed, a.attempt)):
        chosen = (a.estimate_T_world_part, a.estimate_score, a.error_mm, a.error_deg, a.grasp)
        outcome = (a.moved, a.success, str(a.reason), a.parts_in_bin_before, a.n_estimates, len(a.part_poses_after))
        digest.update(json.dumps(_exact(["attempt", a.seed, a.attempt, outcome, chosen])).encode() + b"\n")
        digest.update(np.array(a.part_poses_after, dtype="<f8").tobytes())
    for e in sorted(episodes, key=lambda e: e.seed):
        line = ["episode", e.seed, e.parts_dropped, e.parts_picked, e.end, e.attempts]
        digest.update(json.dumps(_exact(line)).encode() + b"\n")
    return digest.hexdigest()


def _exact(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_exact(v) for v in value]
    return value.hex() if isinstance(value, float) else value
