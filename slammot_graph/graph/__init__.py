"""The pose graph, its part around the local map, and the noise of its odometry factors."""

from slammot_graph.graph.local_factors import LocalFactors
from slammot_graph.graph.pose_graph import PoseGraph, PoseGraphConfig

__all__ = ["LocalFactors", "PoseGraph", "PoseGraphConfig"]
