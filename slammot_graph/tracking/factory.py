"""The trackers there are, by their configuration."""

from slammot_graph.tracking.base import Tracker
from slammot_graph.tracking.no_tracking import NoTracking, NoTrackingConfig
from slammot_graph.tracking.tracker import KalmanTracker, KalmanTrackerConfig

TrackerConfig = NoTrackingConfig | KalmanTrackerConfig


def make_tracker(config: TrackerConfig) -> Tracker:
    """Build a tracker."""
    return NoTracking() if isinstance(config, NoTrackingConfig) else KalmanTracker(config)
