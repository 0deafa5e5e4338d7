"""Which end points move: covariances, the ellipse test, clusters and tracks."""

from slammot_graph.motion.afterimage import Afterimage, AfterimageConfig
from slammot_graph.motion.clusters import ClusterConfig, find_clusters
from slammot_graph.motion.ellipse import Detection, MotionConfig, detect_moving, end_point_covariances
from slammot_graph.motion.probability import probability_of_moving
from slammot_graph.motion.reasons import REASONS
from slammot_graph.motion.tracks import Track, TrackConfig, Tracker

__all__ = [
    "REASONS",
    "Afterimage",
    "AfterimageConfig",
    "ClusterConfig",
    "Detection",
    "MotionConfig",
    "Track",
    "TrackConfig",
    "Tracker",
    "detect_moving",
    "end_point_covariances",
    "find_clusters",
    "probability_of_moving",
]
