"""The pose graph and the factors around the local map: the only importer of gtsam.

Nodes are poses of keyframes, edges are odometry, matches and closures; covariances come from here.
Imports `core` only.
"""

from slammot_graph.graph.local_factors import LocalFactors
from slammot_graph.graph.pose_graph import PoseGraph, PoseGraphConfig

__all__ = ["LocalFactors", "PoseGraph", "PoseGraphConfig"]
