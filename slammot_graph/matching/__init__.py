"""Scan matching: the paper's point-to-point ICP, and ours, point to line on a local map."""

from slammot_graph.matching.local_map import NO_NODE, Keyframe, LocalMap, LocalMapConfig, make_keyframe
from slammot_graph.matching.point_to_line import PointToLineConfig, match_to_local_map
from slammot_graph.matching.point_to_point import PointToPointConfig, match_scans

__all__ = [
    "NO_NODE",
    "Keyframe",
    "LocalMap",
    "LocalMapConfig",
    "PointToLineConfig",
    "PointToPointConfig",
    "make_keyframe",
    "match_scans",
    "match_to_local_map",
]
