import numpy as np

from slammot_graph.tracking.factory import make_tracker
from slammot_graph.tracking.no_tracking import NoTracking, NoTrackingConfig
from slammot_graph.tracking.tracker import KalmanTracker, KalmanTrackerConfig


def test_the_factory_builds_what_the_configuration_names() -> None:
    config = KalmanTrackerConfig(n_confirm=2)
    tracker = make_tracker(config)
    assert isinstance(tracker, KalmanTracker)
    assert tracker.config is config
    assert isinstance(make_tracker(NoTrackingConfig()), NoTracking)


def test_no_tracking_follows_nothing() -> None:
    tracker = NoTracking()
    tracker.update(0.0, np.ones((1, 2)), np.ones((1, 2, 2)), [np.arange(3)])
    assert tracker.shown() == []
    assert tracker.shown_in(np.zeros(3)) == ()
    assert not tracker.on_objects(3).any()
    assert tracker.tracks == tracker.displaced() == []
    assert tracker.predicted_positions(1.0).shape == (0, 2)
