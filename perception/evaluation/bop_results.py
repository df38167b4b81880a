"""Estimates as the CSV file that the BOP evaluation reads: scene_id,im_id,obj_id,score,R,t,time."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from pickproof.cell.frames import invert
from pickproof.perception.data.bop_format import MM
from pickproof.perception.data.bop_read import BopImage
from pickproof.perception.refinement.refine import RefineResult

HEADER = "scene_id,im_id,obj_id,score,R,t,time"


def write_results(path: Path, seen: Iterable[tuple[BopImage, RefineResult]]) -> None:
    """One line an estimate: R row by row and t in [mm] of the dataset's model, time of the whole image in [s]."""
    lines = [HEADER]
    for image, result in seen:
        time = sum(result.seconds.values())
        for estimate in result.estimates:
            T = estimate.T_camera_part @ invert(image.T_model_part)
            R, t = (" ".join(f"{x:.9g}" for x in np.ravel(values)) for values in (T[:3, :3], MM * T[:3, 3]))
            lines.append(f"{image.scene},{image.image},{image.obj},{estimate.score:.6f},{R},{t},{time:.6f}")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
