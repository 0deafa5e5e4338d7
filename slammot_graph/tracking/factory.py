"""The trackers there are, by their configuration."""

from slammot_graph.tracking.base import Tracker
from slammot_graph.tracking.no_tracking import NoTracking, NoTrackingConfig
from slammot_graph.tracking.segment_config import SegmentTrackerConfig
from slammot_graph.tracking.segment_tracker import SegmentTracker
from slammot_graph.tracking.tracker import KalmanTracker, KalmanTrackerConfig

TrackerConfig = NoTrackingConfig | KalmanTrackerConfig | SegmentTrackerConfig


def make_tracker(config: TrackerConfig) -> Tracker:
    """Build a tracker."""
    if isinstance(config, NoTrackingConfig):
        return NoTracking()
    return SegmentTracker(config) if isinstance(config, SegmentTrackerConfig) else KalmanTracker(config)
