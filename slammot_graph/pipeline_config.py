"""The configuration of the pipeline: one part each for localizer, detector, tracker, odometry noise and map."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from slammot_graph.core.checks import Checked, Positive, PositiveShare
from slammot_graph.core.scan import NO_RETURN_FRACTION
from slammot_graph.detection.ellipse_detector import EllipseDetectorConfig
from slammot_graph.detection.no_detection import NoDetectionConfig
from slammot_graph.localization.config import (
    DeadReckoningConfig,
    ScanToLocalMapConfig,
    ScanToMapConfig,
    ScanToScanConfig,
)
from slammot_graph.mapping.final_map import FinalMapConfig
from slammot_graph.mapping.occupancy_grid import GridConfig
from slammot_graph.odometry.noise import ConstantNoise, OdometryNoise
from slammot_graph.tracking.no_tracking import NoTrackingConfig
from slammot_graph.tracking.segment_config import SegmentTrackerConfig
from slammot_graph.tracking.tracker import KalmanTrackerConfig

MOST_RANGE_M = 1000.0
MOST_CELLS_A_SIDE = 8192
"""Of the square around the robot that the laser reaches."""


@dataclass(frozen=True, kw_only=True)
class PipelineConfig(Checked):
    """What a method does: which parts it is made of, and how each is set.

    Attributes
    ----------
    localizer : DeadReckoningConfig, ScanToScanConfig (the paper's), ScanToLocalMapConfig (without a pose graph) or
        ScanToMapConfig (with it)
    detector : NoDetectionConfig or EllipseDetectorConfig
    tracker : NoTrackingConfig, KalmanTrackerConfig (of clusters) or SegmentTrackerConfig (of people)
    odometry_noise : OdometryNoise or ConstantNoise
        R_r of the odometry factors and of the prediction: growing with the motion, or constant as in the paper.
    grid : GridConfig
        Of the map.
    final_map : FinalMapConfig
        How the scans are weighted in the map, where there is a pose graph.
    max_range_m : float
        Farther returns are left aside.
    range_fraction : float
        From this share of the laser's `range_max` on, a range is no return.
    """

    localizer: DeadReckoningConfig | ScanToScanConfig | ScanToLocalMapConfig | ScanToMapConfig = field(
        default_factory=ScanToMapConfig
    )
    detector: NoDetectionConfig | EllipseDetectorConfig = field(default_factory=EllipseDetectorConfig)
    tracker: NoTrackingConfig | KalmanTrackerConfig | SegmentTrackerConfig = field(
        default_factory=SegmentTrackerConfig
    )
    odometry_noise: OdometryNoise | ConstantNoise = field(default_factory=OdometryNoise)
    grid: GridConfig = field(default_factory=GridConfig)
    final_map: FinalMapConfig = field(default_factory=FinalMapConfig)
    max_range_m: Positive = 40.0
    range_fraction: PositiveShare = NO_RETURN_FRACTION

    def __post_init__(self) -> None:
        """See `Checked`."""
        super().__post_init__()
        self.require(
            self.max_range_m <= MOST_RANGE_M,
            f"must be at most {MOST_RANGE_M:g} m, which no such laser reaches, not {self.max_range_m:g}",
            key="max_range_m",
        )
        self._require_memory("grid", self.grid, 0.0)
        if not isinstance(self.detector, EllipseDetectorConfig):
            return
        has_local_grid = self.detector.local_grid is not None
        if self.detector.local_grid is not None:
            local = self.detector.local_grid
            self._require_memory("detector.local_grid", local, local.window_margin_m)
        has_constant_noise = isinstance(self.detector.test_covariance, ConstantNoise)
        name = type(self.localizer).__name__
        self.require(
            has_local_grid or not self.has_graph,
            f"must be given: the map of {name} is made at the end, there is no other grid to test",
            key="detector.local_grid",
        )
        self.require(
            self.has_graph or not has_local_grid,
            f'must be "none": {name} has no keyframes, the map is tested',
            key="detector.local_grid",
        )
        self.require(
            self.has_local_map or has_constant_noise,
            f"must be a table of constant noise: {name} has no pose graph",
            key="detector.test_covariance",
        )

    def _require_memory(self, key: str, grid: GridConfig, margin_m: float) -> None:
        """Refuse cells so small that those in the reach of the laser take more than half a gigabyte."""
        side_m = 2.0 * self.max_range_m + margin_m
        self.require(
            side_m <= MOST_CELLS_A_SIDE * grid.resolution_m,
            f"must be at least {side_m / MOST_CELLS_A_SIDE:.3g} m for a max_range_m of {self.max_range_m:g} m, not"
            f" {grid.resolution_m:g}; take larger cells or a smaller max_range_m",
            key=f"{key}.resolution_m",
        )

    @property
    def has_graph(self) -> bool:
        """Whether the localizer keeps a pose graph, from whose nodes the map is made."""
        return isinstance(self.localizer, ScanToMapConfig)

    @property
    def has_local_map(self) -> bool:
        """Whether the localizer matches onto a local map, to which the covariance of its poses is relative."""
        return self.has_graph or isinstance(self.localizer, ScanToLocalMapConfig)

    @property
    def has_matches(self) -> bool:
        """Whether the localizer matches scans."""
        return not isinstance(self.localizer, DeadReckoningConfig)

    @staticmethod
    def with_new_keys(values: Mapping[str, Any], default: "PipelineConfig", source: str) -> Mapping[str, Any]:
        """Move values from the flat keys of release 0.1 to those of today; see `from_plain`."""
        from slammot_graph.old_keys import with_new_keys

        return with_new_keys(values, default, source)
