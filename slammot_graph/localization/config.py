"""Configuration of the localizers."""

from dataclasses import dataclass, field

import numpy as np

from slammot_graph.core.checks import Checked, Count, NotNegative, Positive, Share
from slammot_graph.core.types import FloatArray
from slammot_graph.graph import PoseGraphConfig
from slammot_graph.loop_closure import LoopClosureConfig
from slammot_graph.mapping.local_map import LocalMapConfig
from slammot_graph.registration.point_to_line import PointToLineConfig
from slammot_graph.registration.point_to_point import PointToPointConfig


@dataclass(frozen=True, kw_only=True)
class DeadReckoningConfig:
    """Odometry alone."""


@dataclass(frozen=True, kw_only=True)
class ScanToScanConfig:
    """The paper's localization: each scan matched onto the one before.

    Attributes
    ----------
    point_to_point : PointToPointConfig
    """

    point_to_point: PointToPointConfig = field(default_factory=PointToPointConfig)


@dataclass(frozen=True, kw_only=True)
class ScanToMapConfig(Checked):
    """Ours: point-to-line matching on a local map, keyframes in a pose graph.

    Attributes
    ----------
    n_lost : int
        After this many failed matches in a row, or this many scans with nothing in sight if the robot may have been
        kidnapped meanwhile, a new local map is started.
    kidnapped_distance_m : float
        A robot whose odometry moved less than this while it saw nothing may have been kidnapped.
    lost_std_m, lost_std_rad : float
        Standard deviations of the motion since the last keyframe when the robot is lost, or the odometry has jumped.
    lost_distance_m : float
        Path length that a lost robot may have been displaced, when it comes to place recognition.
    jump_inlier_ratio, jump_nis : float
        A match with fewer inliers and a larger normalised innovation squared is tried again without the odometry ...
    jump_inlier_gain : float
        ... which is believed where it has that many inliers, and more by this than a match that did not fail.
    max_counted_nis : float
        A single innovation counts for no more than this in the running mean of its normalised square ...
    nis_gain : float
        ... and with this weight.
    close_loops : bool
    local_map, point_to_line, graph, closure
        Configuration of the parts.
    """

    n_lost: Count = 5
    kidnapped_distance_m: NotNegative = 0.2
    lost_std_m: Positive = 3.0
    lost_std_rad: Positive = 0.8
    lost_distance_m: NotNegative = 20.0
    jump_inlier_ratio: Share = 0.6
    jump_nis: Positive = 45.0
    jump_inlier_gain: Share = 0.15
    max_counted_nis: Positive = 50.0
    nis_gain: Share = 0.1
    close_loops: bool = True
    local_map: LocalMapConfig = field(default_factory=LocalMapConfig)
    point_to_line: PointToLineConfig = field(default_factory=PointToLineConfig)
    graph: PoseGraphConfig = field(default_factory=PoseGraphConfig)
    closure: LoopClosureConfig = field(default_factory=LoopClosureConfig)

    @property
    def lost_cov(self) -> FloatArray:
        """(3, 3) covariance of the motion of a lost robot, body frame."""
        return np.diag(np.square((self.lost_std_m, self.lost_std_m, self.lost_std_rad)))
