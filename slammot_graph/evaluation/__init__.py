"""Judging results: plain arrays in, numbers with units out.

One convention for empty sets everywhere: a figure over nothing is NaN and its count `n` is 0.
"""

from slammot_graph.evaluation.consistency import (
    AverageNees,
    Coverage,
    RunConsistency,
    average_nees,
    ellipse_coverage,
    nees,
    pose_errors,
    run_consistency,
)
from slammot_graph.evaluation.maps import MapScores, evaluate_map
from slammot_graph.evaluation.points import (
    PointScores,
    beam_speeds,
    distance_to_wall,
    evaluate_points,
    evaluate_strata,
    motion_strata,
    strata,
)
from slammot_graph.evaluation.relations import Relations, RelationScores, evaluate_relations, read_relations
from slammot_graph.evaluation.stats import ErrorStats, summarize
from slammot_graph.evaluation.tracks import TrackPoints, TrackScores, evaluate_tracks
from slammot_graph.evaluation.trajectories import (
    AbsoluteError,
    RelativeError,
    absolute_error,
    alignment,
    read_trajectory,
    relative_error,
)

__all__ = [
    "AbsoluteError",
    "AverageNees",
    "Coverage",
    "ErrorStats",
    "MapScores",
    "PointScores",
    "RelationScores",
    "Relations",
    "RelativeError",
    "RunConsistency",
    "TrackPoints",
    "TrackScores",
    "absolute_error",
    "alignment",
    "average_nees",
    "beam_speeds",
    "distance_to_wall",
    "ellipse_coverage",
    "evaluate_map",
    "evaluate_points",
    "evaluate_relations",
    "evaluate_strata",
    "evaluate_tracks",
    "motion_strata",
    "nees",
    "pose_errors",
    "read_relations",
    "read_trajectory",
    "relative_error",
    "run_consistency",
    "strata",
    "summarize",
]
