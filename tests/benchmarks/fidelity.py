"""Remakes table and pictures of docs/measurements/physics.md: `python -m tests.benchmarks.fidelity` (two minutes)."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot as plt

from pickproof.cell.grippers.magnet import Magnet
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.grippers.vacuum import VacuumGripper
from pickproof.cell.physics.picture import cell_picture
from pickproof.cell.physics.world import GRAVITY
from pickproof.cell.workpiece.workpiece import load_workpiece
from tests.cell.grippers.one_sided_cell import FACE, OneSidedCell
from tests.cell.physics.laws import down_a_slope, drops, fall, jaw, pad_forces, roller, slip_of_a_grip, stack, tracking
from tests.cell.physics.shaft_cell import carry_shaft
from tests.cell.workpiece.solids import block, turned

IMAGES = Path(__file__).resolve().parents[2] / "docs" / "images"
MASS = 0.3
DOWN = np.array([0.0, 0.0, -1.0])


def grips(axes: Any) -> dict[str, float]:
    """Coulomb's limit of a grip, and the force of the pads."""
    shares = np.array([0.5, 0.8, 0.9, 0.95, 0.98, 1.02, 1.05, 1.1, 1.2])
    slips = np.array([slip_of_a_grip(s) for s in shares])
    axes[0].semilogy(shares, 1e3 * slips, "o-")
    axes[0].axvline(1.0, color="k", ls="--", lw=1)
    axes[0].set(xlabel="load / (2 mu F)", ylabel="slip in 0.5 s [mm]", title="Coulomb limit of a grip")
    asked = np.array([10.0, 20.0, 40.0, 80.0])
    read = np.array([pad_forces(f) for f in asked])
    axes[1].plot(asked, read, "o", asked, asked, "k--", lw=1)
    axes[1].set(xlabel="force of the motor [N]", ylabel="force on each pad [N]", title="Gripper force at rest")
    return {
        "slip_at_0.98_mm": 1e3 * slips[shares == 0.98][0],
        "slip_at_1.02_mm": 1e3 * slips[shares == 1.02][0],
        "pad_force_error": float(np.abs(read / asked[:, None] - 1).max()),
    }


def bodies(axes: Any) -> dict[str, float]:
    """Falling, sliding, rolling."""
    t, z = fall()
    axes[0].plot(t, z, t, GRAVITY * t * t / 2, "k--", lw=1)
    axes[0].set(xlabel="time [s]", ylabel="fallen [m]", title="Free fall")
    angles, mu = np.arange(5, 61, 5), 0.3
    rad = np.deg2rad(angles)
    slide = np.maximum(GRAVITY * (np.sin(rad) - mu * np.cos(rad)), 0.0)
    roll = np.where(np.tan(rad) <= 3 * mu, 2 / 3 * GRAVITY * np.sin(rad), slide)
    slid = np.array([down_a_slope(block((0.06, 0.06, 0.02), MASS), a, mu) for a in rad])
    rolled = np.array([down_a_slope(roller(), a, mu) for a in rad])
    axes[1].plot(angles, slid, "o", label="block")
    axes[1].plot(angles, rolled, "s", label="cylinder")
    axes[1].plot(angles, slide, "k--", angles, roll, "k:", lw=1)
    axes[1].set(xlabel="slope [deg]", ylabel="acceleration [m/s2]", title="Sliding and rolling, mu 0.3")
    axes[1].legend()
    return {
        "fall_error": float(abs(z[-1] / (GRAVITY * t[-1] ** 2 / 2) - 1)),
        "slide_error_m_s2": float(np.abs(slid - slide).max()),
        "roll_error": float(np.abs(rolled / roll - 1).max()),
    }


def pulled_off(
    gripper: VacuumGripper | Magnet, force: np.ndarray, moment: np.ndarray, most: float
) -> tuple[float, float]:
    """Load at which a plate comes off, and the gap [m] under the face."""
    cell = OneSidedCell.build(gripper, block((0.06, 0.06, 0.02), MASS), gap=0.0001)
    load = cell.pull(force, moment, 2 * most, 3 * most) if cell.held else 0.0
    cell.world.close()
    return load, cell.gap


def pads(axes: Any) -> dict[str, float]:
    """What cups and magnets lose a plate at."""
    cup, magnet = load_gripper("cup_20"), load_gripper("magnet_20")
    assert isinstance(cup, VacuumGripper) and isinstance(magnet, Magnet)
    rest, errors = cup.force - MASS * GRAVITY, []
    angles = np.deg2rad([0, 15, 30, 45, 60, 75, 90])  # between pull and shear
    for a in angles:
        normal, shear = np.cos(a), np.sin(a)
        expected = rest / (normal + shear / cup.friction)
        got, _ = pulled_off(cup, np.array([shear, 0.0, -normal]), np.zeros(3), expected)
        axes[0].plot(got * shear, got * normal, "o", color="C0")
        errors.append(got / expected - 1)
    axes[0].plot([0, cup.friction * rest], [rest, 0], "k--", lw=1)
    axes[0].set(xlabel="shear [N]", ylabel="pull [N] beside the weight", title="Cup: where it comes off")
    bends = []
    for share_of_pull in (0.0, 0.3, 0.6):
        plate, moment = block((0.06, 0.06, 0.02), MASS), np.array([1.0, 0.0, 0.0])
        cell = OneSidedCell.build(replace(cup, pressure=cup.pressure * (1 - share_of_pull)), plate)
        pressing = cell.arm.gripper.force - MASS * GRAVITY  # type: ignore[attr-defined]
        got = cell.pull(np.zeros(3), moment, pressing * cup.radius, 1.0)
        cell.world.close()
        bends.append((pressing, got))
        errors.append(got / (pressing * cup.radius / 2) - 1)
    pressing, got = np.array(bends).T
    axes[1].plot(pressing, 1e3 * got, "o", pressing, 1e3 * pressing * cup.radius / 2, "k--", lw=1)
    axes[1].set(xlabel="vacuum less weight [N]", ylabel="bending moment [mN m]", title="Cup: where its lip lifts")
    covers = np.array([0.0, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0]) * 1e-3
    gaps, forces = [], []
    for cover in covers:
        load, gap = pulled_off(replace(magnet, cover=cover), DOWN, np.zeros(3), magnet.pull(cover))
        gaps.append(gap + cover)
        forces.append(load + MASS * GRAVITY)
    fine = np.linspace(0, 1.2e-3, 50)
    axes[2].plot(1e3 * np.array(gaps), forces, "o", 1e3 * fine, [magnet.pull(g) for g in fine], "k--", lw=1)
    axes[2].set(xlabel="gap [mm]", ylabel="pull-off [N]", title="Magnet")
    expected = [magnet.pull(g) for g in gaps]
    return {
        "cup_error": float(np.abs(errors).max()),
        "magnet_error": float(np.abs(np.array(forces) / expected - 1).max()),
    }


def rest(axes: Any) -> dict[str, float]:
    """Servo, stack, drops."""
    for share in (1.0, 0.5):
        t, error = tracking(share)
        axes[0].plot(t, 1e6 * error, label=f"{share:g} of the limits")
    axes[0].set(xlabel="time [s]", ylabel="largest joint error [urad]", title="Joint servo")
    axes[0].legend()
    t, drift = stack()
    axes[1].plot(t, 1e6 * drift)
    axes[1].set(xlabel="time [s]", ylabel="largest drift [um]", title="Six blocks on each other")
    through = {}
    for speed in (2.0, 3.0, 4.0):
        where, deepest, outside = drops(100, speed)
        through[f"outside_at_{speed:g}_m_s"] = float(outside)
        if speed == 3.0:
            axes[2].plot(*(1e3 * where[:, :2].T), ".")
            through["deepest_mm"] = 1e3 * deepest
    axes[2].plot([-150, 150, 150, -150, -150], [-110, -110, 110, 110, -110], "k-")
    axes[2].set(xlabel="x [mm]", ylabel="y [mm]", title="100 drops at up to 3 m/s", aspect="equal")
    return {"servo_error_rad": float(error.max()), "stack_drift_m": float(drift.max()), **through}


def shaft(axes: Any) -> dict[str, float]:
    """Slip of the heavy shaft while it is lifted and carried."""
    figures = {}
    grooved = jaw("jaw_v_shaft")
    cases = {
        "V-groove, rubber": (grooved, None),
        "flat, rubber": (replace(grooved, groove=None), None),
        "V-groove, steel 0.15": (replace(grooved, friction=0.15), 0.15),
        "flat, steel 0.15": (replace(grooved, friction=0.15, groove=None), 0.15),
        "jaw_v1 at 80 N": (jaw(force=80.0), None),
    }
    for name, (gripper, friction) in cases.items():
        done = carry_shaft(gripper, friction=friction, picture=name == "V-groove, rubber")
        axes[0].semilogy(done.trace[:, 0] - done.trace[0, 0], np.maximum(1e3 * done.trace[:, 1], 1e-3), label=name)
        figures[f"{name}: held"] = float(done.held)
        figures[f"{name}: slip_mm"], figures[f"{name}: turn_deg"] = 1e3 * done.slip, done.turn_deg
        if done.picture is not None:
            cv2.imwrite(str(IMAGES / "fidelity-shaft.png"), done.picture[:, :, ::-1])
    axes[0].axhline(2.0, color="k", ls="--", lw=1)
    axes[0].set(xlabel="time [s]", ylabel="slip [mm]", title="3.9 kg shaft, lifted and carried at 8 m/s2")
    axes[0].legend(fontsize=8)
    return figures


def gallery() -> None:
    """A plate on the cup and on the magnet, and the long profile on the bar of cups."""
    pictures = []
    for name, eye in (("cup_20", 0.35), ("magnet_20", 0.35), ("cup_bar", 0.9)):
        workpiece = turned(load_workpiece("ps6d_23")) if name == "cup_bar" else block((0.06, 0.06, 0.02), MASS)
        cell = OneSidedCell.build(load_gripper(name), workpiece, gap=0.0)
        x, y, z = FACE
        pictures.append(cell_picture(cell.world, (x + eye, y - 0.6 * eye, z + 0.25 * eye), (x, y, z + 0.03), 420, 420))
        cell.world.close()
    cv2.imwrite(str(IMAGES / "fidelity-grippers.png"), np.hstack(pictures)[:, :, ::-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="write the figures here as well")
    IMAGES.mkdir(exist_ok=True)
    args, out = parser.parse_args(), {}
    gallery()
    for run, panels in ((grips, 2), (bodies, 2), (pads, 3), (rest, 3), (shaft, 1)):
        figure, axes = plt.subplots(1, panels, figsize=(4.2 * panels if panels > 1 else 7, 3.4), squeeze=False)
        out[run.__name__] = run(axes[0])
        figure.tight_layout()
        name = "shaft-slip" if run is shaft else run.__name__
        figure.savefig(IMAGES / f"fidelity-{name}.png", dpi=90)
        plt.close(figure)
        for key, value in out[run.__name__].items():
            print(f"{run.__name__:8s} {key:28s} {value:.4g}", flush=True)
    if args.json:
        args.json.write_text(json.dumps(out, indent=2))


if __name__ == "__main__":
    main()
