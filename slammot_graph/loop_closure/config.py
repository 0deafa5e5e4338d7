"""Configuration of loop closure: all thresholds in one place, those of its parts in parts of their own."""

from dataclasses import dataclass, field

from slammot_graph.core.checks import (
    Checked,
    Count,
    CountOrZero,
    NotNegative,
    Positive,
    PositiveOrInfinite,
    Share,
)
from slammot_graph.loop_closure.relocalization import RelocalizationConfig
from slammot_graph.loop_closure.submap import SubmapConfig
from slammot_graph.registration.point_to_line import PointToLineConfig


@dataclass(frozen=True, kw_only=True)
class ConsistencyConfig(Checked):
    """When two closures say the same.

    Attributes
    ----------
    min_number_gap : int
        The later local maps of both lie at least this many numbers apart: neighbours share their keyframes.
    max_path_m : float
        Path length between the earlier and between the later local maps, both together.
    std_m, std_m_per_m, std_rad, std_rad_per_m : float
        Standard deviation of what the graph says of these paths, and its growth along them.
    """

    min_number_gap: CountOrZero = 2
    max_path_m: Positive = 40.0
    std_m: Positive = 0.05
    std_m_per_m: NotNegative = 0.01
    std_rad: Positive = 0.02
    std_rad_per_m: NotNegative = 0.002


@dataclass(frozen=True, kw_only=True)
class LoopClosureConfig(Checked):
    """When two local maps may be the same place, and what it takes to believe it.

    Attributes
    ----------
    min_path_m : float
        Path length between two local maps before they can close a loop.
    max_distance_m : float
        Their centres lie nearer than this, the search radius included.
    drift_scale : float
        Factor on the standard deviations of the graph's relative pose: matches of neighbouring scans share
        errors (the same wall, the same beams), which the graph takes for independent.
    blind_scale : float
        The same factor for a drive with nothing in sight, of which the odometry alone tells.
    sigma_scale : float
        The search covers this many standard deviations of their relative pose ...
    min_search_m, max_search_m, min_search_rad, max_search_rad : float
        ... within these bounds.
    n_candidates, n_candidates_lost : int
        Local maps that are looked at per finished one, the nearest first; and while the robot is lost.
    known_overlap : float
        A local map of which this share lies on an earlier one shows a known place: it is not looked at again, and the
        graph gets no more nodes there than its local maps are attached to.
    min_score : float
        Share of the best possible agreement that the search must reach.
    min_overlap : float
        Share of the points that find a partner after the match.
    max_free_space_violation : float
        Largest share of points in free space, of those in seen space.
    max_ambiguity : float
        Refused if a second pose scores more than this share of the first.
    gate : float
        Squared Mahalanobis distance to the graph's own belief below which a closure is taken at once (16.27: 99.9%).
    gate_scale : float
        Up to this many times the standard deviations a closure is taken once another one confirms it.
    max_residual2 : float
        A closure whose residual after the update is above this, in its own covariance, is taken out again.
    candidate_margin_m : float
        The centres of two local maps may lie this much farther from each other than the search covers.
    candidate_spacing, candidate_spacing_lost : int
        Local maps that are looked at lie this many numbers from each other, as neighbours overlap; and while the robot
        is lost.
    n_search_points_lost : int
        About so many points are searched with while the robot is lost: a search of the full circle has to save time.
    turn_lever_quantile, min_turn_lever_m : float
        A step of the search in angle moves points by one cell at this quantile of their distances, which counts as
        no less than this.
    same_pose_m, same_pose_rad : float
        A second pose within both of the first is no other one.
    match_prior_std_m, match_prior_std_rad : float
        Of the pose that the match starts from, so that it has some hold where the points give none.
    min_inlier_share : float
        Share of the points that agree after the match, as a share of `min_overlap`.
    n_prepared : int
        Score grids of so many local maps are kept.
    point_to_line : PointToLineConfig
    consistency : ConsistencyConfig
        When one closure confirms another.
    relocalization : RelocalizationConfig
    submap : SubmapConfig
    """

    min_path_m: Positive = 8.0
    max_distance_m: Positive = 12.0
    drift_scale: Positive = 5.0
    blind_scale: Positive = 1.5
    sigma_scale: Positive = 6.0
    min_search_m: Positive = 0.5
    max_search_m: Positive = 8.0
    min_search_rad: Positive = 0.15
    max_search_rad: Positive = 0.8
    n_candidates: Count = 3
    n_candidates_lost: Count = 7
    min_score: Share = 0.38
    min_overlap: Share = 0.55
    known_overlap: Share = 0.8
    max_free_space_violation: Share = 0.2
    max_ambiguity: Share = 0.9
    gate: PositiveOrInfinite = 16.27
    gate_scale: Positive = 4.0
    max_residual2: Positive = 150.0
    candidate_margin_m: Positive = 4.0
    candidate_spacing: Count = 4
    candidate_spacing_lost: Count = 2
    n_search_points_lost: Count = 200
    turn_lever_quantile: Share = 0.9
    min_turn_lever_m: Positive = 1.0
    same_pose_m: Positive = 0.5
    same_pose_rad: Positive = 0.1
    match_prior_std_m: Positive = 1.0
    match_prior_std_rad: Positive = 0.5
    min_inlier_share: Share = 0.7
    n_prepared: Count = 64
    point_to_line: PointToLineConfig = field(
        default_factory=lambda: PointToLineConfig(floor_std_m=0.01, max_iterations=30)
    )
    consistency: ConsistencyConfig = field(default_factory=ConsistencyConfig)
    relocalization: RelocalizationConfig = field(default_factory=RelocalizationConfig)
    submap: SubmapConfig = field(default_factory=SubmapConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require(self.min_search_m <= self.max_search_m, "must be at most max_search_m", "min_search_m")
        self.require(
            self.min_search_rad <= self.max_search_rad, "must be at most max_search_rad", "min_search_rad"
        )
