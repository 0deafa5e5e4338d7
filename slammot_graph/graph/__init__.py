"""The pose graph on GTSAM's incremental smoother."""

from slammot_graph.graph.pose_graph import PoseGraph, PoseGraphConfig

__all__ = ["PoseGraph", "PoseGraphConfig"]
