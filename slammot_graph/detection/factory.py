"""The detectors there are, by their configuration."""

from slammot_graph.detection.base import Detector
from slammot_graph.detection.ellipse_detector import EllipseDetector, EllipseDetectorConfig
from slammot_graph.detection.no_detection import NoDetection, NoDetectionConfig
from slammot_graph.mapping.occupancy_grid import OccupancyGrid

DetectorConfig = NoDetectionConfig | EllipseDetectorConfig


def make_detector(
    config: DetectorConfig, *, max_range_m: float, map_grid: OccupancyGrid | None = None
) -> Detector:
    """Build a detector.

    Parameters
    ----------
    config : NoDetectionConfig or EllipseDetectorConfig
    max_range_m : float
        Range of the farthest points.
    map_grid : OccupancyGrid, optional
        The map as it grows, for a detector that has no grid of its own.
    """
    if isinstance(config, NoDetectionConfig):
        return NoDetection()
    return EllipseDetector(config, max_range_m=max_range_m, map_grid=map_grid)
