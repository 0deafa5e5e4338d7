"""The pose graph, and its factors around the local map.

`smoother` is the only importer of gtsam. Imports `core`.
"""

from slammot_graph.graph.local_factors import LocalFactors
from slammot_graph.graph.pose_graph import PoseGraph, PoseGraphConfig

__all__ = ["LocalFactors", "PoseGraph", "PoseGraphConfig"]
