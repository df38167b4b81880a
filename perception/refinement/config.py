"""Every threshold between votes and verified poses, in one place.

Lengths are in units, `Workpiece.unit`, unless [m] is said. `RefineConfig` holds the others; each module takes the part
that it needs.
"""

from __future__ import annotations

from pydantic import Field

from pickproof.cell.config import Config, Sigma
from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.ps6d.pose_fitting import FitConfig
from pickproof.perception.ps6d.voting import ClusterConfig


class HypothesisConfig(Config):
    """Where hypotheses come from and how many are kept."""

    place_bandwidth: float = Field(0.12, gt=0, description="of the search for places by position alone, in units")
    min_votes_place: float = Field(4, gt=0, description="fewest votes of such a place, per 1,000 votes")
    max_places: int = Field(80, ge=1, description="places tried, those with most votes")
    votes_per_place: int = Field(8, ge=0, description="single predicted rotations tried at each place")
    near_symmetries: bool = Field(True, description="turn each hypothesis by the near symmetries of the CAD")
    slide_reach: float = Field(0.25, ge=0, description="how far slender parts are shifted along their axis, in units")
    slide_step: float = Field(0.05, gt=0, description="in units")
    gather_votes: int = Field(
        500, ge=8, description="votes, evenly spaced, to which hypotheses of compact parts are fitted"
    )
    keep: int = Field(6, ge=1, description="hypotheses of a place that go into coarse ICP")
    keep_after_coarse: int = Field(2, ge=1, description="hypotheses of a place that go into fine ICP")
    tolerance: float = Field(0.07, gt=0, description="of the score before ICP, in units")
    points: int = Field(64, ge=8, description="CAD points of that score")
    screen_points: int = Field(20, ge=8, description="CAD points of a first score, which keeps 4 x `keep` of a place")
    apart: float = Field(0.06, ge=0, description="two hypotheses of a place nearer than this, in units, are one")
    alike: float = Field(0.005, ge=0, description="the same before they are turned and scored, in units")
    slender: int = Field(3, ge=1, description="factor of votes_per_place, keep and keep_after_coarse on slender parts")

    def of(self, shape: ShapeModel) -> HypothesisConfig:
        """The settings for a workpiece."""
        if not shape.slender:
            return self
        names = ("votes_per_place", "keep", "keep_after_coarse")
        return self.model_copy(update={name: self.slender * getattr(self, name) for name in names})


class RegistrationConfig(Config):
    """Which hypotheses go on to the next stage of ICP; its iterations are `icp.COARSE`, `FINE` and `LAST`."""

    coarse_points: int = Field(128, ge=8, description="CAD points of the score after coarse ICP")
    coarse_tolerance: float = Field(0.03, gt=0, description="of that score, in units")
    apart_in_place: float = Field(
        0.03, ge=0, description="after coarse ICP, two poses of a place nearer than this are one"
    )
    apart_after_coarse: float = Field(0.02, ge=0, description="the same for poses of any places")
    apart_after_fine: float = Field(0.01, ge=0, description="the same after fine ICP")
    screen_every: int = Field(2, ge=1, description="one in this many CAD points is compared before the last ICP")
    screen_slack: float = Field(
        0.2, ge=0, le=1, description="how far below `min_ratio` a pose may be before the last ICP"
    )


class VerifyConfig(Config):
    """Thresholds of verification; lengths in units, `Workpiece.unit`."""

    tolerance: float = Field(0.005, ge=0, description="added to the sensor's share of the inlier distance")
    sigmas: float = Field(4.0, ge=0, description="the sensor's share, in standard deviations")
    min_ratio: float = Field(0.80, ge=0, le=1, description="least inliers / (inliers + violations)")
    min_visible: float = Field(0.15, ge=0, le=1, description="least confirmed share of the surface facing the camera")
    min_score: float | None = Field(None, ge=0, le=1, description="least score; none: the threshold of the score model")
    points: int = Field(384, ge=32, description="CAD points compared, for each unit of the part's length")
    max_shared: float = Field(0.35, ge=0, le=1, description="most of its surface owned by better poses")
    max_overlap: float = Field(0.05, ge=0, le=1, description="most of its surface deep inside a better pose")
    overlap_depth: float = Field(0.15, gt=0, description="what deep means, in thicknesses of the part")


class RefineConfig(Config):
    """Settings of everything after the network."""

    cluster: ClusterConfig = ClusterConfig()
    fit: FitConfig | None = Field(None, description="poses by all votes of a category too; only figures need them")
    hypotheses: HypothesisConfig = HypothesisConfig()
    registration: RegistrationConfig = RegistrationConfig()
    verify: VerifyConfig = VerifyConfig()
    second_round: bool = Field(True, description="search again among the votes that no accepted pose explains")
    hypotheses_second: HypothesisConfig = HypothesisConfig(votes_per_place=24, keep=4, max_places=8, min_votes_place=5)
    depth_sigma: Sigma | None = Field(
        None, description="[m] standard deviation of a measured depth; none: what the frame says"
    )
