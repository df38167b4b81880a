"""Selection of the attempts of a campaign that are stored for replay."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

Which = Literal["failures", "all", "none"]
KEPT: tuple[Which, ...] = get_args(Which)


@dataclass(frozen=True)
class Keep:
    """Which attempts of a campaign are kept in its folder: failures with every EVERYth success, all, or none."""

    directory: Path
    which: Which = "failures"
