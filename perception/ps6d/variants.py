"""The peers and ablations of PS6D's Tables I and II: one network, configured (`pickproof train --variant`).

Single-stage clustering, the third ablation, needs no training: `ClusterConfig(two_stage=False)`.
"""

from __future__ import annotations

from dataclasses import replace

from pickproof.cell.errors import InputError
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.ps6d.network import NetworkConfig
from pickproof.perception.ps6d.voting import ClusterConfig

FIXED_UNIT = 0.1
"""[m] what coordinates are measured in without normalisation: the side of the paper's normalised cube."""

PLAIN = NetworkConfig(local_frames=False, cad_head=False)
VARIANTS = {
    "ps6d": NetworkConfig(),
    "no_local_frames": NetworkConfig(local_frames=False),
    "no_cad_head": NetworkConfig(cad_head=False),
    "plain": PLAIN,
    "pointnet2_msg": NetworkConfig(backbone="pointnet2_msg"),
    "no_normalisation": NetworkConfig(coordinate_scale=1.0),
    "ppr_net_pp": replace(PLAIN, backbone="pointnet2_msg", heads="ppr_net"),
}
"""Rows of the tables: ours (`ps6d`), each of our additions left out, the paper's own network (`plain`), its two trained
ablations applied to ours, and the peer PPR-Net++, whose weights serve PPR-Net too (`ppr_net.py`)."""


def network_config(variant: str, workpiece: Workpiece) -> NetworkConfig:
    """The network of a variant for one workpiece.

    Raises:
        InputError: no such variant.
    """
    if variant not in VARIANTS:
        raise InputError("command line", "--variant", variant, f"one of {', '.join(VARIANTS)}")
    config = VARIANTS[variant]
    fixed = config.coordinate_scale is not None
    return replace(config, coordinate_scale=workpiece.unit / FIXED_UNIT) if fixed else config


def variant_of(config: NetworkConfig) -> str:
    """Name of the variant a network is of, whatever its sizes and its workpiece; `custom` for any other."""
    return next((name for name, variant in VARIANTS.items() if same_variant(config, variant)), "custom")


def same_variant(a: NetworkConfig, b: NetworkConfig) -> bool:
    """Whether two networks differ in nothing but sizes and workpiece."""

    def parts(c: NetworkConfig) -> tuple[object, ...]:
        return c.local_frames, c.cad_head, c.backbone, c.heads, c.coordinate_scale is None

    return parts(a) == parts(b)


def cluster_config(network: NetworkConfig, config: ClusterConfig) -> ClusterConfig:
    """Clustering of a network's votes: without normalisation the bandwidths are in FIXED_UNIT, not in units."""
    lengths = ("position_bandwidth", "rotation_bandwidth", "merge_bandwidth")
    return config.model_copy(update={name: getattr(config, name) / network.scale for name in lengths})
