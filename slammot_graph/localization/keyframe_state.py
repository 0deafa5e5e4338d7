"""What is known since the last keyframe and since the last node, and where the local frame lies in the map."""

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.types import FloatArray
from slammot_graph.localization.base import FIRST_COV, fuse
from slammot_graph.localization.common_errors import CommonErrors
from slammot_graph.localization.node_errors import NodeErrors


class KeyframeState:
    """The latest keyframe and the latest node; not every keyframe has a node.

    Attributes
    ----------
    T_odom_keyframe, T_odom_node : (3,) arrays
        Dead-reckoned poses at both.
    T_local_node : (3,) array
    T_map_local : (3,) array
        The local frame in the map, by the optimised pose of a node.
    common_errors : CommonErrors
        What the odometry's errors have in common has done to the nodes.
    node_errors : NodeErrors
        Where the errors of the nodes come from.
    cov_since_node : (3, 3) array
        Of the odometry's motion from the node to the keyframe.
    cov_keyframe : (3, 3) array
        Of the keyframe relative to the local map's anchor, as the graph counts it. Both are right perturbations
        (body frame of the keyframe).
    """

    def __init__(self) -> None:
        self.T_odom_keyframe: FloatArray = se2.IDENTITY
        self.T_odom_node: FloatArray = se2.IDENTITY
        self.T_local_node: FloatArray = se2.IDENTITY
        self.common_errors = CommonErrors()
        self.node_errors = NodeErrors()
        self.T_map_local: FloatArray = se2.IDENTITY
        self.cov_since_node: FloatArray = np.zeros((3, 3))
        self.cov_keyframe: FloatArray = FIRST_COV

    def start(self, T_odom_base: FloatArray) -> None:
        """Take the first keyframe."""
        self.T_odom_keyframe = T_odom_base

    def advance(
        self, T_odom_base: FloatArray, cov_odometry: FloatArray, match: MatchResult | None
    ) -> FloatArray:
        """Move on to a new keyframe.

        Parameters
        ----------
        T_odom_base : (3,) array
            Its dead-reckoned pose.
        cov_odometry : (3, 3) array
            Of the odometry's motion since the last keyframe, right perturbation (body frame).
        match : MatchResult or None

        Returns
        -------
        (3,) array
            Its pose in the frame of the last keyframe, by odometry.
        """
        T_last_this = se2.between(self.T_odom_keyframe, T_odom_base)
        self.cov_since_node = se2.compound_covariance(self.cov_since_node, T_last_this, cov_odometry)
        self.cov_keyframe = se2.compound_covariance(self.cov_keyframe, T_last_this, cov_odometry)
        if match is not None and match.status != "failed":
            self.cov_keyframe = fuse(self.cov_keyframe, match)
        self.T_odom_keyframe = T_odom_base
        return T_last_this

    def since_node(self, T_odom_base: FloatArray) -> FloatArray:
        """(3,) motion since the last node, by odometry."""
        return se2.between(self.T_odom_node, T_odom_base)

    def on_node(self, T_local_base: FloatArray) -> FloatArray:
        """(3,) pose in the frame of the last node, by the matches."""
        return se2.between(self.T_local_node, T_local_base)

    def start_node(self, T_odom_base: FloatArray, T_local_base: FloatArray, T_map_node: FloatArray) -> None:
        """Make the keyframe a node, at a pose (3,) in the map."""
        self.T_local_node = T_local_base
        self.place_node(T_map_node)
        self.T_odom_node = T_odom_base
        self.cov_since_node = np.zeros((3, 3))

    def place_node(self, T_map_node: FloatArray) -> None:
        """Place the local frame so that the last node lies at its optimised pose (3,) in the map."""
        self.T_map_local = se2.compose(T_map_node, se2.inverse(self.T_local_node))
