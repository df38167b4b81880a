"""What exists in the cell: workpieces, bins, the arm and its gripper, the camera, and the physics that moves them.

The only folder that imports pybullet or casts rays.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pickproof.cell.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from pickproof.cell.errors import InputError, PickproofError, SimulationError
    from pickproof.cell.geometry.bin import Bin
    from pickproof.cell.grippers.base import Gripper
    from pickproof.cell.grippers.registry import list_grippers, load_gripper
    from pickproof.cell.physics.world import World
    from pickproof.cell.sensing.camera import DepthFrame, Intrinsics
    from pickproof.cell.sensing.sensor_model import SensorConfig
    from pickproof.cell.symmetry.symmetry import Symmetry
    from pickproof.cell.workpiece.workpiece import Workpiece, list_workpieces, load_workpiece

__all__ = [
    "Bin",
    "DepthFrame",
    "Gripper",
    "InputError",
    "Intrinsics",
    "PickproofError",
    "SensorConfig",
    "SimulationError",
    "Symmetry",
    "Workpiece",
    "World",
    "list_grippers",
    "list_workpieces",
    "load_gripper",
    "load_workpiece",
]

_MODULES = {
    "Bin": "geometry.bin",
    "DepthFrame": "sensing.camera",
    "Gripper": "grippers.base",
    "InputError": "errors",
    "Intrinsics": "sensing.camera",
    "PickproofError": "errors",
    "SensorConfig": "sensing.sensor_model",
    "SimulationError": "errors",
    "Symmetry": "symmetry.symmetry",
    "Workpiece": "workpiece.workpiece",
    "World": "physics.world",
    "list_grippers": "grippers.registry",
    "list_workpieces": "workpiece.workpiece",
    "load_gripper": "grippers.registry",
    "load_workpiece": "workpiece.workpiece",
}

__getattr__, __dir__ = lazy_exports(__name__, _MODULES)
