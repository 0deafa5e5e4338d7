"""Evaluation: plain arrays and result types in, numbers with units out; a figure over nothing is NaN, its `n` 0.

May import `core` and `logs` (true poses are those of a log); neither a method's parts nor `run_folder`.
Public: the names below.
"""

from slammot_graph.evaluation.comparison import ComparedRun, compare, true_path
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
from slammot_graph.evaluation.mot_challenge import write_mot_challenge
from slammot_graph.evaluation.objects import (
    EstimatedTracks,
    ObjectScores,
    TrueObjects,
    estimated_tracks,
    evaluate_objects,
    evaluate_run_tracks,
    read_objects,
)
from slammot_graph.evaluation.paired import bootstrap_median, holm, median_text, p_text, paired_p
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
from slammot_graph.evaluation.tracks import (
    TrackMatches,
    TrackPoints,
    TrackScores,
    evaluate_tracks,
    match_tracks,
)
from slammot_graph.evaluation.trajectories import (
    AbsoluteError,
    RelativeError,
    absolute_error,
    alignment,
    path_length,
    relative_error,
)
from slammot_graph.evaluation.truth import (
    MAX_DIFFERENCE_S,
    TruePath,
    TruthScores,
    associate,
    evaluate_truth,
    find_truth,
    read_truth,
)

__all__ = [
    "MAX_DIFFERENCE_S",
    "AbsoluteError",
    "AverageNees",
    "ComparedRun",
    "Coverage",
    "ErrorStats",
    "EstimatedTracks",
    "MapScores",
    "ObjectScores",
    "PointScores",
    "RelationScores",
    "Relations",
    "RelativeError",
    "RunConsistency",
    "TrackMatches",
    "TrackPoints",
    "TrackScores",
    "TrueObjects",
    "TruePath",
    "TruthScores",
    "absolute_error",
    "alignment",
    "associate",
    "average_nees",
    "beam_speeds",
    "bootstrap_median",
    "compare",
    "distance_to_wall",
    "ellipse_coverage",
    "estimated_tracks",
    "evaluate_map",
    "evaluate_objects",
    "evaluate_points",
    "evaluate_relations",
    "evaluate_run_tracks",
    "evaluate_strata",
    "evaluate_tracks",
    "evaluate_truth",
    "find_truth",
    "holm",
    "match_tracks",
    "median_text",
    "motion_strata",
    "nees",
    "p_text",
    "paired_p",
    "path_length",
    "pose_errors",
    "read_objects",
    "read_relations",
    "read_truth",
    "relative_error",
    "run_consistency",
    "strata",
    "summarize",
    "true_path",
    "write_mot_challenge",
]
