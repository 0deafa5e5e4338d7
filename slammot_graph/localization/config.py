"""Configuration of the localizers."""

from dataclasses import dataclass, field

import numpy as np

from slammot_graph.core.checks import (
    AtLeastOne,
    Checked,
    Count,
    NotNegative,
    Positive,
    PositiveOrInfinite,
    PositiveShare,
    Share,
)
from slammot_graph.core.types import FloatArray
from slammot_graph.graph import PoseGraphConfig
from slammot_graph.localization.company import CompanyConfig
from slammot_graph.loop_closure import LoopClosureConfig
from slammot_graph.mapping.local_map import LocalMapConfig
from slammot_graph.odometry.adaptive import AdaptiveOdometryConfig
from slammot_graph.registration.point_to_line import PointToLineConfig
from slammot_graph.registration.point_to_point import PointToPointConfig


@dataclass(frozen=True, kw_only=True)
class DeadReckoningConfig:
    """Odometry alone."""


@dataclass(frozen=True, kw_only=True)
class StepConfig(Checked):
    """How far the robot moves from one cycle of match and map to the next; the first bound that is reached counts.

    The paper's R_r = diag(0.1^2, 0.1^2, 0.05^2) is the error of the odometry after such a step.

    Attributes
    ----------
    distance_m : float
        Path by the odometry.
    turn_rad : float
        Turns by the odometry, left and right added up.
    time_s : float
    maps_between : bool
        The scans in between go into the map, at the poses that the odometry tells.
    """

    distance_m: PositiveOrInfinite = 0.25
    turn_rad: PositiveOrInfinite = 0.1
    time_s: PositiveOrInfinite = 2.0
    maps_between: bool = True


@dataclass(frozen=True, kw_only=True)
class ScanToScanConfig:
    """The paper's localization: a scan matched onto the one of the cycle before.

    Attributes
    ----------
    step : StepConfig or None
        None: every scan is a cycle. Else the odometry carries pose and covariance in between, and the scans there are
        tested for moving points, but not matched; one without odometry is always a cycle.
    point_to_point : PointToPointConfig
    """

    step: StepConfig | None = None
    point_to_point: PointToPointConfig = field(default_factory=PointToPointConfig)


@dataclass(frozen=True, kw_only=True)
class ScanToLocalMapConfig:
    """Between the paper's localization and ours, for the comparison: onto a local map, without a pose graph.

    Attributes
    ----------
    step : StepConfig or None
        See `ScanToScanConfig`.
    matcher : PointToPointConfig or PointToLineConfig
        Points pair with points of the local map, or with the lines through them.
    local_map : LocalMapConfig
    """

    step: StepConfig | None = None
    matcher: PointToPointConfig | PointToLineConfig = field(default_factory=PointToLineConfig)
    local_map: LocalMapConfig = field(default_factory=LocalMapConfig)


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
    motion_dof : float
        Degrees of freedom of Student's t for the error of the predicted motion: 4 is far from Gaussian.
    min_tail_nis, min_tail_scale : float
        From this normalised innovation squared on its scale is looked for, and from this scale on the match is
        repeated ...
    tail_gain : float
        ... and taken where so many more of the returns agree, or `min_agreement` of them ...
    min_tail_share, tail_lever_m : float
        ... provided that this share of the agreeing returns tells of the direction of the innovation, a turn counted
        as its arc at the lever: one person ahead is less.
    usual_share : float
        A match with which a smaller share of the returns agrees than this times the usual one is doubtful ...
    usual_gain : float
        ... the usual one being a running mean with this weight of the latest match ...
    agreement_gain : float
        ... and one from another start is believed where so many more agree.
    turn_reach, turn_step_rad : float
        Starts are turned in these steps up to so many standard deviations of the predicted heading.
    astray_share : float
        Where a smaller share of the returns agrees than this times the usual one, nothing is known of the heading: they
        are turned all around ...
    astray_lead : float
        ... and a pose is believed with which so many times as many agree as with any other, `usual_share` of the usual.
    slip_lever_m : float
        Where only the heading contradicts the odometry, as down a bare corridor, the wheels have slipped, and the way
        is as uncertain as that turn times this: half a track where one wheel slips alone, more where both do.
    adrift_m : float
        Where the motion since the scan before is known less well, as after a gap without odometry, starts are shifted
        as well, in steps of this length ...
    shift_reach : float
        ... up to so many standard deviations ...
    adrift_share : float
        ... and a start is believed where so large a share agrees of what usually does: the robot may be beyond.
    min_agreement : float
        Where a larger share of all returns agrees with a match, it may contradict the prediction; those on something
        that moves disagree.
    close_loops : bool
    company : CompanyConfig or None
        Of people who set out together with a robot that stood; None: they are matched like all else, unless they were
        called moving.
    odometry, local_map, point_to_line, graph, closure
        Configuration of the parts.
    """

    n_lost: Count = 5
    kidnapped_distance_m: NotNegative = 0.2
    lost_std_m: Positive = 3.0
    lost_std_rad: Positive = 0.8
    lost_distance_m: NotNegative = 20.0
    motion_dof: Positive = 4.0
    min_tail_nis: NotNegative = 6.0
    min_tail_scale: AtLeastOne = 1.5
    tail_gain: Share = 0.05
    min_tail_share: Share = 0.1
    tail_lever_m: Positive = 3.0
    usual_share: Share = 0.75
    usual_gain: PositiveShare = 0.05
    agreement_gain: Share = 0.05
    turn_reach: Positive = 2.5
    turn_step_rad: Positive = 0.3
    astray_share: Share = 0.5
    astray_lead: AtLeastOne = 1.5
    slip_lever_m: NotNegative = 1.0
    adrift_m: Positive = 0.5
    shift_reach: Positive = 1.5
    adrift_share: Share = 0.9
    min_agreement: Share = 0.75
    close_loops: bool = True
    company: CompanyConfig | None = field(default_factory=CompanyConfig)
    odometry: AdaptiveOdometryConfig = field(default_factory=AdaptiveOdometryConfig)
    local_map: LocalMapConfig = field(default_factory=LocalMapConfig)
    point_to_line: PointToLineConfig = field(default_factory=PointToLineConfig)
    graph: PoseGraphConfig = field(default_factory=PoseGraphConfig)
    closure: LoopClosureConfig = field(default_factory=LoopClosureConfig)

    @property
    def lost_cov(self) -> FloatArray:
        """(3, 3) covariance of the motion of a lost robot, body frame."""
        return np.diag(np.square((self.lost_std_m, self.lost_std_m, self.lost_std_rad)))
