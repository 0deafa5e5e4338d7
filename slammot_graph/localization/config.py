"""Configuration of the localization on a local map."""

from dataclasses import dataclass, field

import numpy as np

from slammot_graph.core.errors import ConfigError
from slammot_graph.core.types import FloatArray
from slammot_graph.graph import PoseGraphConfig
from slammot_graph.loop_closure import LoopClosureConfig
from slammot_graph.mapping.local_map import LocalMapConfig
from slammot_graph.registration.point_to_line import PointToLineConfig


@dataclass(frozen=True, kw_only=True)
class ScanToMapConfig:
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
        Path length that a lost robot may have been carried, when it comes to recognising places.
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

    n_lost: int = 5
    kidnapped_distance_m: float = 0.2
    lost_std_m: float = 3.0
    lost_std_rad: float = 0.8
    lost_distance_m: float = 20.0
    jump_inlier_ratio: float = 0.6
    jump_nis: float = 45.0
    jump_inlier_gain: float = 0.15
    max_counted_nis: float = 50.0
    nis_gain: float = 0.1
    close_loops: bool = True
    local_map: LocalMapConfig = field(default_factory=LocalMapConfig)
    point_to_line: PointToLineConfig = field(default_factory=PointToLineConfig)
    graph: PoseGraphConfig = field(default_factory=PoseGraphConfig)
    closure: LoopClosureConfig = field(default_factory=LoopClosureConfig)

    def __post_init__(self) -> None:
        if self.n_lost < 1:
            raise ConfigError(f"n_lost must be at least 1, not {self.n_lost}")
        for name in ("lost_std_m", "lost_std_rad", "jump_nis", "max_counted_nis"):
            if not getattr(self, name) > 0.0:
                raise ConfigError(f"{name} must be positive, not {getattr(self, name)}")
        for name in ("kidnapped_distance_m", "lost_distance_m"):
            if not getattr(self, name) >= 0.0:
                raise ConfigError(f"{name} must not be negative, not {getattr(self, name)}")
        for name in ("jump_inlier_ratio", "jump_inlier_gain", "nis_gain"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ConfigError(f"{name} must be in [0, 1], not {getattr(self, name)}")

    @property
    def lost_cov(self) -> FloatArray:
        """(3, 3) covariance of the motion of a lost robot, body frame."""
        return np.diag(np.square((self.lost_std_m, self.lost_std_m, self.lost_std_rad)))
