"""`--data` and `--bop`: scenes of the user's own in place of those that training and evaluation settle."""

from __future__ import annotations

import argparse
from pathlib import Path

from pickproof.cell.errors import InputError
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.data.bop_read import read_bop
from pickproof.perception.data.scene_set import SceneSet
from pickproof.perception.training.dataset import Scene


def add_source_arguments(parser: argparse.ArgumentParser) -> None:
    """--data, --bop, --split, --bop-sensor and --obj."""
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--data", type=Path, metavar="DIR", help="scenes that `pickproof generate` settled")
    source.add_argument("--bop", type=Path, metavar="DIR", help="depth images and poses of a BOP dataset")
    parser.add_argument("--split", default=None, help="of --bop, as train_pbr (default: the only one)")
    parser.add_argument("--bop-sensor", default=None, metavar="NAME", help="of --bop with several, as photoneo")
    parser.add_argument("--obj", type=int, default=None, metavar="ID", help="object of --bop (default: the only one)")


def given_scenes(args: argparse.Namespace, workpiece: Workpiece, workers: int) -> list[Scene] | None:
    """The scenes that the arguments name; None for those that the command settles itself.

    Raises:
        InputError: no such scenes.
    """
    for option, value in (("--split", args.split), ("--bop-sensor", args.bop_sensor), ("--obj", args.obj)):
        if value is not None and args.bop is None:
            raise InputError("command line", option, value, "to stand beside --bop DIR")
    if args.bop is not None:
        if not args.bop.is_dir():
            raise InputError("command line", "--bop", str(args.bop), "the folder of a BOP dataset")
        return list(read_bop(args.bop, args.split, args.obj, workpiece, args.bop_sensor))
    if args.data is not None:
        return list(SceneSet.load(args.data, workpiece.name).heaps(workers))
    return None
