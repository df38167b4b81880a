"""Prints the figures of docs/explanation/physics.md: `python -m tests.cell.physics.measure_physics` (about a minute;
CPU time of one core)."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from pickproof.cell.frames import make_transform
from pickproof.cell.geometry.bin import table
from pickproof.cell.physics._pybullet import pybullet
from pickproof.cell.physics.bin_filling import fill_bin
from pickproof.cell.physics.trajectory_execution import close_jaws, finger_forces, held_parts, wait
from pickproof.cell.physics.world import World
from pickproof.cell.workpiece.workpiece import load_workpiece
from tests.cell.physics.grasp_cell import PLACE, R_DOWN, GraspCell
from tests.cell.physics.test_bin_filling import BIN

WAKE = {"activationState": pybullet.ACTIVATION_STATE_WAKE_UP}


def cpu_ms(step: Callable[[], object], n: int) -> float:
    start = time.process_time()
    for _ in range(n):
        step()
    return 1e3 * (time.process_time() - start) / n


def heap(iterations: int, seed: int) -> None:
    world = World(solver_iterations=iterations)
    world.add_box(table((1.6, 1.6, 0.04), (0.3, 0.0, 0.0)))
    world.add_bin(BIN)
    start = time.process_time()
    settled = fill_bin(world, load_workpiece("bracket"), BIN, 30, np.random.default_rng(seed))
    fill = time.process_time() - start
    asleep = cpu_ms(world.step, 240)
    deepest = -1e3 * min(c[8] for c in world.client.getContactPoints())
    for body in world.parts:
        world.client.changeDynamics(body, -1, **WAKE)
    awake = cpu_ms(world.step, 240)
    drift = 1e3 * np.abs(world.part_poses() - settled.Ts_world_part)[:, :3, 3].max()
    print(
        f"{iterations:3d} iterations, seed {seed}: fill {fill:.2f} s, step asleep {asleep:.3f} ms,"
        f" awake {awake:.3f} ms, deepest contact {deepest:.3f} mm, drift awake in 0.5 s {drift:.3f} mm"
    )
    world.close()


def grasp(iterations: int, dt: float, anchor: bool = True) -> None:
    default = World.__init__.__defaults__
    World.__init__.__defaults__ = (dt, iterations)  # type: ignore[misc]  # GraspCell builds its own world
    built = GraspCell.build()
    World.__init__.__defaults__ = default  # type: ignore[misc]
    world, arm = built.world, built.arm
    if not anchor:
        for body, link in ((world.parts[0], -1), *((arm.body, f) for f in arm.finger_links)):
            world.client.changeDynamics(body, link, frictionAnchor=0)
    above = built.above()
    built.line(built.grasp(), 15.0)
    close_jaws(world, arm)
    forces = finger_forces(world, arm)
    built.mark()
    over = make_transform(R_DOWN, (*PLACE.position[:2], 0.2))
    log = built.line(above, 15.0) + built.line(over, 15.0)
    step = cpu_ms(world.step, 200)
    for T in (above, over, above, over):
        log += built.line(T, 15.0)
    wait(world, arm, 1.0)
    built._look()
    setting = f"1/{1 / dt:.0f} s, {iterations:3d} iterations, anchors {'on' if anchor else 'off'}"
    slip = f"slip {1e3 * built.slip:.3f} mm {built.slip_deg:.3f} deg"
    pads = f"pads {forces[0]:.1f} and {forces[1]:.1f} N"
    print(f"{setting}: held {held_parts(world, arm)}, {slip}, {pads}, tracking {log.max_error:.1e} rad, {step:.3f} ms")
    world.close()


if __name__ == "__main__":
    for iterations in (20, 30, 50, 100):
        for seed in (0, 1):
            heap(iterations, seed)
    for dt in (1 / 240, 1 / 480, 1 / 960):
        grasp(50, dt)
    for iterations in (20, 30, 100):
        grasp(iterations, 1 / 480)
    grasp(50, 1 / 480, anchor=False)
