"""The physics gives the same bits in another process: a settled heap, and a pick after it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from pickproof.cell.physics.trajectory_execution import close_jaws, open_jaws
from tests.cell.physics.grasp_cell import GraspCell
from tests.cell.physics.test_bin_filling import filled

ROOT = Path(__file__).resolve().parents[3]


def heap_and_pick() -> str:
    """Poses of a settled heap and of a bracket that was picked and let fall, as hexadecimal bytes."""
    world, heap = filled(2)
    world.close()
    cell = GraspCell.build()
    above = cell.above()
    cell.line(cell.grasp(), 8.0)
    close_jaws(cell.world, cell.arm)
    cell.line(above, 8.0)
    open_jaws(cell.world, cell.arm)
    cell.world.run_until_rest(2.0)
    poses = heap.Ts_world_part.tobytes() + cell.world.part_poses().tobytes() + cell.arm.q.tobytes()
    cell.world.close()
    return poses.hex()


@pytest.mark.slow
def test_two_processes_agree_bit_for_bit() -> None:
    code = "from tests.cell.physics.test_determinism import heap_and_pick; print(heap_and_pick())"
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert other.stdout.split()[-1] == heap_and_pick()
