"""What cell suits a part: bin, camera, arm and grippers by its size and weight, each with its reason in words.

Sizes between those of the shipped workpieces are read off lines through what these have; their bins and cameras are
those of heaps on which perception learned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from pickproof.cell.grippers.base import Gripper
from pickproof.cell.grippers.magnet import Magnet
from pickproof.cell.grippers.parallel_jaw import ParallelJaw
from pickproof.cell.grippers.registry import list_grippers, load_gripper
from pickproof.cell.sensing.sensor_model import SensorConfig
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.robots.kinematics.model import load_robot
from pickproof.scenarios.config.scenario import BinConfig
from pickproof.scenarios.placing.slot_grid import slots_in

LONGEST = (0.01, 0.03, 0.056, 0.083, 0.145, 0.216, 0.30, 0.436, 1.304)
BIN_LENGTH = (0.16, 0.22, 0.24, 0.33, 0.45, 0.53, 0.76, 0.80, 1.46)
"""[m] of the longest side of workpieces, and of their bins, in which a gripper must have room beside small ones."""
SEEN_LENGTH = (0.12, 0.22, 0.26, 0.45, 0.52, 0.78, 1.46)
DISTANCE = (0.55, 0.70, 0.85, 0.95, 1.00, 1.12, 1.15)
"""[m] of bins, and of the camera over them."""
PACKED = 0.4
"""Share of the bin's volume that the bounding boxes of a full heap take."""
FLOOR = 0.6
"""Of the floor that the workpieces of a scenario would cover if all lay flat: fingers need room beside each."""
SAFETY, PULL = 2.0, 12.0
"""Over the weight, and [m/s2] of lift and transfer."""
SITES: dict[str, dict[str, Any]] = {
    "lrmate200id": {"source": 0.45, "place_x": 0.15, "widest": 0.34, "place": (0.47, 0.40)},
    "lrmate200id7l": {"source": 0.50, "place_x": 0.22, "widest": 0.54, "place": (0.72, 0.42)},
    "m20id25": {"source": 1.10, "place_x": 0.0, "widest": 1.50, "place": (1.28, 0.90)},
}
"""Where arms have their bins in the shipped scenarios: x of either [m], longest source bin, largest place bin.

A robot that is not in this table is never proposed."""
LARGE_TABLE = {"size": [3.6, 3.6, 0.05], "centre_top": [0.2, 0.0, 0.0]}
OVER = 0.01


@dataclass(frozen=True)
class Heap:
    """The heap that fits a part: fields of workpiece.yaml, and the reason."""

    bin_inner: tuple[float, float, float]
    count: tuple[int, int]
    camera_distance: float
    reason: str

    @property
    def tolerance(self) -> float:
        """[m] that three standard deviations of the depth at the floor hide."""
        return 3 * float(SensorConfig.model_validate({}).sigma_at(self.camera_distance))


def propose_heap(extents: np.ndarray) -> Heap:
    """Bin, count and camera for a part of these extents (3,) in [m]."""
    thin, middle, longest = (float(e) for e in np.sort(extents))
    length = round(float(np.interp(longest, LONGEST, BIN_LENGTH)), 2)
    width = round(min(0.77 * length, 0.56), 2)
    depth = round(min(1.2 * middle + 0.055, 0.22), 2)
    most = int(np.clip(PACKED * length * width * depth / (thin * middle * longest), 4, 40))
    distance = round(float(np.interp(length, SEEN_LENGTH, DISTANCE)), 2)
    filled = most * thin * middle * longest / (length * width * depth)
    reason = (
        f"{1000 * longest:.0f} mm long: a bin {length / longest:.1f} times as long, which {most} parts fill to "
        f"{100 * filled:.0f} %; the camera {distance:.2f} m over the floor sees the whole of it at "
        f"{1000 * max(length, width * 4 / 3) * 1.15 / 640:.2f} mm a pixel"
    )
    return Heap((length, width, depth), (max(most // 3, 3), most), distance, reason)


@dataclass(frozen=True)
class Choice:
    """A gripper that may do, and why; or why it may not."""

    gripper: Gripper
    fits: bool
    reason: str


def rank_grippers(workpiece: Workpiece, bin_depth: float) -> list[Choice]:
    """All shipped grippers, those that may hold the part first and the most suitable of them in front."""
    choices = [_judge(load_gripper(name), workpiece, bin_depth) for name in list_grippers()]
    return [choice for _, choice in sorted(choices, key=lambda pair: pair[0])]


def _judge(gripper: Gripper, workpiece: Workpiece, bin_depth: float) -> tuple[float, Choice]:
    """A rank, the lowest first, and the choice."""
    thin = float(workpiece.extents.min())
    need = SAFETY * workpiece.mass * (9.81 + PULL)
    if isinstance(gripper, ParallelJaw):
        hold = 2 * gripper.force * math.sqrt(gripper.friction * workpiece.friction)
        if thin > gripper.max_opening - 0.01:
            return 9.0, Choice(gripper, False, f"opens {1000 * gripper.max_opening:.0f} mm, the part is "
                               f"{1000 * thin:.0f} mm thick")  # fmt: skip
        if hold < need:
            return 9.0, Choice(gripper, False, f"holds {hold:.0f} N by friction of {need:.1f} N needed")
        short = bin_depth > gripper.finger_size[2]
        round_one = workpiece.symmetry.infinite_axis is not None
        rank = 1.0 * short + (0.5 if (gripper.groove is not None) != round_one else 0.0) + 0.1 * gripper.mass
        reason = f"opens {1000 * gripper.max_opening:.0f} mm, holds {hold:.0f} N by friction of {need:.1f} N needed"
        if short:
            fingers = 1000 * gripper.finger_size[2]
            reason += f"; its fingers of {fingers:.0f} mm are short for a bin {1000 * bin_depth:.0f} mm deep"
        return rank, Choice(gripper, True, reason)
    if isinstance(gripper, Magnet):
        if not workpiece.magnetic:
            return 9.0, Choice(gripper, False, "a magnet does not hold this material")
        return 4.0, Choice(gripper, True, "a magnet, for magnetic parts that no jaw takes")
    return 3.0 + gripper.mass, Choice(gripper, True, "cups, for flat faces of parts that no jaw takes")


def propose_cell(workpiece: Workpiece, gripper: Gripper, heap: Heap) -> tuple[dict[str, Any], dict[str, str]]:
    """Fields of a scenario, and the reason of each choice; empty fields where no arm carries the part."""
    load = workpiece.mass + gripper.mass
    for robot in sorted(SITES, key=lambda name: SITES[name]["widest"]):
        site, model = SITES[robot], load_robot(robot)
        if heap.bin_inner[0] <= site["widest"] and load < 0.9 * model.payload:
            break
    else:
        return {}, {"robot": f"no shipped arm carries {load:.1f} kg over a bin of {heap.bin_inner[0]:.2f} m"}
    length, width, _ = heap.bin_inner
    _, middle, longest = (float(e) for e in np.sort(workpiece.extents))
    lying = int(FLOOR * length * heap.bin_inner[1] / (middle * longest))
    count = max(1, min(round(0.7 * heap.count[1]), max(lying, heap.count[0]), 30))
    place, count = _place_bin(workpiece, site, count)
    covered = count * middle * longest / (length * width)
    wall = round(max(0.006, 0.02 * length), 4)
    eye = [site["source"], 0.0, round(OVER + heap.camera_distance, 3)]
    fov = 2 * math.degrees(math.atan(max(length, width * 4 / 3) / 2 * 1.15 / heap.camera_distance))
    away = -round(width / 2 + place[1] / 2 + (0.14 if site["widest"] < 1 else 0.35), 2)
    fields: dict[str, Any] = {
        "count": count,
        "robot": robot,
        "gripper": gripper.name,
        "source_bin": {"inner": list(heap.bin_inner), "wall": wall, "position": [site["source"], 0.0, OVER]},
        "place_bin": {"inner": place, "wall": 0.008, "position": [site["place_x"], away, OVER]},
        "camera": {"width": 640, "height": 480, "fov_deg": round(fov, 1), "eye": eye,
                   "target": [site["source"], 0.0, OVER], "sensing_time_s": 0.4},
    }  # fmt: skip
    if site["widest"] > 1:
        fields["table"] = LARGE_TABLE
    if workpiece.mass > 1.0:
        fields["carry"] = {"speed_scale": 0.5}
    reasons = {
        "robot": f"{robot}: part and gripper weigh {load:.2f} kg of {model.payload:.0f} kg, and its reach of "
        f"{model.reach:.2f} m covers a bin of {length:.2f} m",
        "place bin": f"{place[0]:.2f} x {place[1]:.2f} m has a slot for each of {count} parts",
        "count": f"{count}, which lying flat would cover {100 * covered:.0f} % of the floor: fingers need room beside "
        f"each; heaps for perception have {heap.count[1]} at most",
    }
    return fields, reasons


def _place_bin(workpiece: Workpiece, site: dict[str, Any], count: int) -> tuple[list[float], int]:
    """Inner sizes [m] of the smallest bin with a slot for each part, and how many have one."""
    thin, width, length = (float(e) for e in np.sort(workpiece.extents))
    reach = math.hypot(length, width)
    widest, deepest = site["place"]
    along = max(min(math.ceil(math.sqrt(count * widest / deepest)), int(widest / reach)), 1)
    rows = max(min(math.ceil(count / along), int(deepest / reach)), 1)
    inner = [max(round(along * reach + 0.005, 3), 0.16), max(round(rows * reach + 0.005, 3), 0.12)]
    inner.append(round(min(max(0.5 * thin, 0.03), 0.12), 3))
    if along * rows < count:  # one layer is too small: the largest bin, in lanes or layers
        inner[:2] = [widest, deepest]
    place = BinConfig(inner=(inner[0], inner[1], inner[2]), position=(0.0, 0.0, 0.0)).build("place")
    return inner, min(count, slots_in(place, workpiece, count).capacity)
