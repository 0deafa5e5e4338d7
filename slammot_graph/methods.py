"""The method registry: a name for each frozen configuration; an ablation changes one field."""

from dataclasses import dataclass, replace

from slammot_graph.baselines.kiss_icp import KissIcpConfig
from slammot_graph.core.errors import ConfigError
from slammot_graph.detection.clustering import ClusterConfig
from slammot_graph.detection.ellipse_detector import EllipseDetectorConfig
from slammot_graph.detection.ellipse_test import EllipseTestConfig
from slammot_graph.detection.no_detection import NoDetectionConfig
from slammot_graph.localization.config import (
    DeadReckoningConfig,
    ScanToMapConfig,
    ScanToScanConfig,
    StepConfig,
)
from slammot_graph.mapping.occupancy_grid import GridConfig, NoReturnConfig
from slammot_graph.odometry.noise import ConstantNoise
from slammot_graph.pipeline_config import PipelineConfig
from slammot_graph.registration.point_to_point import PointToPointConfig
from slammot_graph.tracking.no_tracking import NoTrackingConfig
from slammot_graph.tracking.tracker import KalmanTrackerConfig

Config = PipelineConfig | KissIcpConfig


@dataclass(frozen=True, kw_only=True)
class Method:
    """A name, what it stands for, and its configuration."""

    name: str
    summary: str
    config: Config


_GRAPH = PipelineConfig()
_ELLIPSE = EllipseDetectorConfig()
_ICP = PipelineConfig(
    localizer=ScanToScanConfig(),
    detector=NoDetectionConfig(),
    tracker=NoTrackingConfig(),
    grid=GridConfig(fill_gaps=False, occupy_with_moving=True, no_return=NoReturnConfig()),
)
_DETECTOR = EllipseDetectorConfig(
    test_covariance=ConstantNoise(),
    ellipse_test=EllipseTestConfig(margin_cells=None, track_reach_m=None),
    clusters=ClusterConfig(split=None),
    visibility_check=None,
    retest=None,
    backward_pass=False,
    local_grid=None,
)
_DOCPFO = replace(_ICP, detector=_DETECTOR, tracker=KalmanTrackerConfig())

_STEPWISE = ScanToScanConfig(
    step=StepConfig(distance_m=0.25, turn_rad=0.1, time_s=2.0),
    point_to_point=PointToPointConfig(
        max_distance_m=2.0, kept_share=0.8, max_gap_m=2.0, tau_m=1e-6, max_iterations=300
    ),
)
"""What the paper leaves open, as `experiments.paper_search` found it; so is the size of the ellipse below."""
_STEPWISE_DETECTOR = replace(_DETECTOR, ellipse_test=replace(_DETECTOR.ellipse_test, n_sigma=1.0))

METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        Method(
            name="odometry",
            summary="dead reckoning on the wheels, no matching",
            config=replace(_ICP, localizer=DeadReckoningConfig()),
        ),
        Method(
            name="icp",
            summary="the paper's ICP: scan to scan, point to point, once a step of the odometry, no filter",
            config=replace(_ICP, localizer=_STEPWISE),
        ),
        Method(
            name="docpfo",
            summary="the paper: icp on points that the test with constant R_r calls static, map from all points",
            config=replace(_DOCPFO, localizer=_STEPWISE, detector=_STEPWISE_DETECTOR),
        ),
        Method(
            name="icp-every-scan",
            summary="icp at each scan, nearest points without interpolation",
            config=_ICP,
        ),
        Method(
            name="docpfo-every-scan",
            summary="docpfo at each scan, nearest points without interpolation, ellipse of 95%",
            config=_DOCPFO,
        ),
        Method(
            name="graph",
            summary="ours: point to line on a local map, pose graph, test with the marginal relative to its anchor",
            config=_GRAPH,
        ),
        Method(
            name="graph-fixed",
            summary="graph, with the paper's constant R_r in the test",
            config=replace(_GRAPH, detector=replace(_ELLIPSE, test_covariance=ConstantNoise())),
        ),
        Method(
            name="graph-absolute",
            summary="graph, with the absolute marginal in the test",
            config=replace(_GRAPH, detector=replace(_ELLIPSE, test_covariance="absolute")),
        ),
        Method(
            name="graph-nofilter",
            summary="graph, without a moving-point test",
            config=replace(_GRAPH, detector=NoDetectionConfig(), tracker=NoTrackingConfig()),
        ),
        Method(
            name="graph-noloop",
            summary="graph, without loop closure",
            config=replace(_GRAPH, localizer=ScanToMapConfig(close_loops=False)),
        ),
        Method(
            name="kiss-icp",
            summary="kiss-icp 1.3 on z = 0 points, best 2D setting, constant velocity start",
            config=KissIcpConfig(),
        ),
        Method(
            name="kiss-icp-odometry",
            summary="kiss-icp, started from the odometry, best 2D setting of such a start",
            config=KissIcpConfig(
                use_odometry=True,
                max_range_m=40.0,
                max_points_per_voxel=20,
                match_spacing_m=0.05,
            ),
        ),
    )
}


def get_method(name: str) -> Method:
    """Look a method up.

    Raises
    ------
    ConfigError
        There is none of that name; the text lists those that are.
    """
    if name not in METHODS:
        raise ConfigError(f'no method "{name}"; there are {", ".join(METHODS)}')
    return METHODS[name]
