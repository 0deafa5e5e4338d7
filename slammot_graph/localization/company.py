"""Who walks along with the robot: small things that alone pull a match away from the odometry.

People who stand around a robot that stands are a part of its local map. When all set out together they go on matching
it, and in a corridor, whose walls agree with any pose along it, nothing else tells how far the robot has gone: the
match says that it stands. Two rigid motions explain the scan then, that of the small things and that of the odometry;
where the rest of the scan agrees as well with the odometry, and no keyframe from elsewhere has seen the things where
they are, they are taken for people. The match is made without them, and is as uncertain as the rest leaves it.

What is large may ride along as well, as the floor before a robot on a ramp: a match that leaps away from the odometry
is not believed where it is such things alone that it explains better.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.checks import Checked, Count, NotNegative, Positive, Share
from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.mapping.local_map import LocalMap
from slammot_graph.registration import _company_kernels

SUPPORT_M = 0.1
"""So near to a point of the local map a return agrees with it, where two poses are compared."""

FAR_SHARE, PROOF_SHARE = 0.05, 0.2
"""Shares of the returns. Where more than the first speak for a match by what was seen from elsewhere, it is not what
rides along that does; where more than the second, the robot is there."""


@dataclass(frozen=True, kw_only=True)
class CompanyConfig(Checked):
    """When small things are left out of a match.

    Attributes
    ----------
    min_nis : float
        A match whose normalised innovation squared is less is not looked at.
    nis_share : float
        The match without them must have less than this share of it ...
    min_agreement : float
        ... this share of the rest of the scan must agree with it ...
    crowd_share, crowd_nis_share : float
        Where more than this share of a scan moves, company is likely: the second in place of `nis_share`, no
        `min_agreement` is asked for, and all that is left out walks along, not just what pulls.
    agreement_margin : float
        ... and as many of its points as with the other one, but for this share.
    gap_m, gap_ratio : float
        A thing ends where the next beam's point is farther than the gap and this share of its range.
    width_m : float
        What is longer is no person, nor two who walk side by side.
    parallax_m : float
        What keyframes from this far away have seen where it is stays there.
    reach_m : float
        So near to their points.
    min_points : int
        Fewer on small things pull nothing away.
    min_rest : float
        The rest must have so many points for each of theirs.
    """

    min_nis: Positive = 2.5
    nis_share: Share = 0.2
    min_agreement: Share = 0.95
    crowd_share: Share = 0.15
    crowd_nis_share: Share = 0.4
    agreement_margin: NotNegative = 0.005
    gap_m: Positive = 0.05
    gap_ratio: NotNegative = 0.04
    width_m: Positive = 1.2
    parallax_m: Positive = 0.5
    reach_m: Positive = 0.15
    min_points: Count = 5
    min_rest: NotNegative = 0.3


class CompanyCheck:
    """What of a scan may walk along.

    Attributes
    ----------
    config : CompanyConfig
    walks_along : (n,) bool array or None
        Beams that pulled the match of the latest scan away; they were left out of it.
    """

    def __init__(self, config: CompanyConfig) -> None:
        self.config = config
        self.walks_along: BoolArray | None = None
        self._thing: IntArray = np.empty(0, dtype=np.int64)
        self._n_things = 0

    def start_scan(self) -> None:
        """Move on to the next scan."""
        self.walks_along = None

    def is_crowd(self, static_share: float) -> bool:
        """Tell whether so much of a scan was called moving that its small things are probably people as well."""
        return 1.0 - static_share > self.config.crowd_share

    def is_likely(self, match: MatchResult, without: MatchResult, static_share: float) -> bool:
        """Tell whether a match without small things explains the scan and the odometry where that with them does not.

        Parameters
        ----------
        match, without : MatchResult
            With them and without.
        static_share : float
            Of the scan's returns, those that were not called moving.
        """
        config = self.config
        if without.status == "failed":
            return False
        if self.is_crowd(static_share):
            return without.nis < config.crowd_nis_share * match.nis
        return without.nis < config.nis_share * match.nis and without.inlier_ratio >= config.min_agreement

    def suspects(
        self, local_map: LocalMap, points_base: FloatArray, is_static: BoolArray, T_local_base: FloatArray
    ) -> BoolArray | None:
        """(n,) points on small things that may walk along, the scan matched at a pose (3,); None if not worth a match.

        Parameters
        ----------
        local_map : LocalMap
        points_base : (n, 2) array [m]
            In beam order.
        is_static : (n,) bool array
            Those that the match used.
        T_local_base : (3,) array
        """
        config = self.config
        self._thing = thing = np.empty(len(points_base), dtype=np.int64)
        self._n_things = n_things = _company_kernels.small_things(
            points_base, is_static, config.gap_m, config.gap_ratio, config.width_m, thing
        )
        is_suspect = np.empty(len(points_base), dtype=np.bool_)
        n_suspect = _company_kernels.may_walk_along(
            thing,
            n_things,
            se2.transform(T_local_base, points_base),
            *local_map.owned_points,
            config.reach_m,
            T_local_base[0],
            T_local_base[1],
            config.parallax_m,
            is_suspect,
        )
        n_rest = np.count_nonzero(is_static) - n_suspect
        if n_suspect < config.min_points or n_rest < config.min_rest * n_suspect:
            return None
        return is_suspect

    def pulling(
        self,
        local_map: LocalMap,
        points_base: FloatArray,
        is_suspect: BoolArray,
        T_with: FloatArray,
        T_without: FloatArray,
    ) -> BoolArray:
        """(n,) suspects, as just found, that pull to where they are matched (3,) from the pose without them (3,)."""
        is_pulling = is_suspect.copy()
        _company_kernels.keep_pulling(
            self._thing,
            self._n_things,
            se2.transform(T_with, points_base),
            se2.transform(T_without, points_base),
            local_map.points,
            local_map.normals,
            local_map.nearest,
            local_map.inv_cell,
            local_map.first,
            self.config.reach_m,
            is_pulling,
        )
        return is_pulling

    def support(
        self,
        local_map: LocalMap,
        points_base: FloatArray,
        is_used: BoolArray,
        T_predicted: FloatArray,
        T_matched: FloatArray,
    ) -> "Support":
        """Tell which of the points (n, 2) lie near the local map at a match (3,), and which at its prediction (3,)."""
        at_match, at_prediction = (se2.transform(T, points_base) for T in (T_matched, T_predicted))
        counts = np.empty((3, 2), dtype=np.int64)
        _company_kernels.count_supported(
            at_match,
            at_prediction,
            is_used,
            *local_map.owned_points,
            SUPPORT_M,
            T_matched[0],
            T_matched[1],
            self.config.parallax_m,
            counts,
        )
        return Support(counts[0], counts[1], counts[2], int(np.count_nonzero(is_used)))


class Support(NamedTuple):
    """How many points lie near the local map at a match alone, at its prediction alone, and at both; of how many.

    Each as two numbers: near what keyframes close by saw, and near what was seen from elsewhere.
    """

    gained: IntArray
    lost: IntArray
    both: IntArray
    n: int

    @property
    def far_share(self) -> float:
        """Of the points, those near what was seen from elsewhere at the match, less those so at the prediction."""
        return float(self.gained[1] - self.lost[1]) / max(self.n, 1)

    @property
    def is_proof(self) -> bool:
        """Whether so much speaks for the match that cannot ride along that the odometry is wrong."""
        return self.far_share > PROOF_SHARE

    @property
    def rides_along(self) -> bool:
        """Whether what speaks for the match rides along with the robot.

        Most of it lies then near what keyframes close by saw, and most of what agrees with both poses, as the building
        does, near what was seen from elsewhere; and of that hardly more speaks for the match than for the prediction.
        """
        is_near = self.gained[0] > self.gained[1] and self.both[1] > self.both[0]
        return bool(is_near and self.far_share <= FAR_SHARE)

    @property
    def gained_share(self) -> float:
        """Of the points, those near the local map at the match, less those near it at the prediction."""
        return float(self.gained.sum() - self.lost.sum()) / max(self.n, 1)
