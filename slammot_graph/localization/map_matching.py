"""A scan matched onto the local map, also where the prediction is wrong."""

import math
from dataclasses import replace
from operator import itemgetter

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.match_result import MEAN_NIS, UNLIKELY_NIS, MatchResult
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.localization.base import fuse
from slammot_graph.localization.company import CompanyCheck
from slammot_graph.localization.config import ScanToMapConfig
from slammot_graph.localization.matchers import matcher_failing_below, noisier_matcher
from slammot_graph.localization.other_starts import leads, shifted_starts, some_of, turned_starts
from slammot_graph.localization.recent_scans import RecentScans
from slammot_graph.mapping.local_map import LocalMap
from slammot_graph.odometry._motion_kernels import heavy_tail_scale
from slammot_graph.odometry.propagation import MotionState
from slammot_graph.registration.base import Match, Matcher, MatchPrior
from slammot_graph.registration.factory import make_matcher

_HELD_COV = 1e-10 * np.eye(3)
"""Of a prior so certain that a match stays where it starts."""


class MapMatching:
    """Point-to-line matching of one scan after the other onto the local map.

    Attributes
    ----------
    config : ScanToMapConfig
    local_map : LocalMap
        Must hold a keyframe.
    matcher : Matcher
    laser_base : (2,), (1, 2) or (n, 2) array
        Where the beams of the latest scan start from, base frame [m].
    is_adrift : bool
        So little was known of the motion to the latest scan that another place within reach may look alike, as after a
        gap without odometry.
    """

    def __init__(self, config: ScanToMapConfig, local_map: LocalMap) -> None:
        self.config = config
        self.local_map = local_map
        self.matcher = make_matcher(config.point_to_line)
        self.laser_base: FloatArray = np.zeros(2)
        self._recent = RecentScans()
        self._static_share = 1.0
        self._usual_agreement = 0.0
        self._noise_scale = 1.0
        self._elsewhere: MotionState | None = None
        self._latest: MatchResult | None = None
        self.is_adrift = False
        self._company = None if config.company is None else CompanyCheck(config.company)

    def start_scan(
        self,
        laser_base: FloatArray,
        T_local_before: FloatArray,
        *,
        has_odometry: bool = False,
        most_change_m: float = math.inf,
    ) -> None:
        """Move on to the next scan.

        Parameters
        ----------
        laser_base : (2,), (1, 2) or (n, 2) array
            Where all beams or each start from, base frame [m].
        T_local_before : (3,) array
            The pose at the scan before.
        has_odometry : bool
            There is odometry, without which who walks along cannot be told from the building, and which holds against
            a match that few returns agree with.
        most_change_m : float
            How far the robot can have come off the motion that the odometry tells.
        """
        self._recent.start_scan(T_local_before, has_odometry=has_odometry, most_change_m=most_change_m)
        self.laser_base = laser_base
        if self._latest is not None and self._latest.status == "converged":
            agreement = self.agreement(self._latest)
            self._usual_agreement += self.config.usual_gain * (agreement - self._usual_agreement)
        self._latest = self._elsewhere = None
        self.is_adrift = False
        if self._company is not None:
            self._company.start_scan()

    def scale_noise(self, scale: float) -> None:
        """Take the noise of matches for so many times what the configuration says, from now on."""
        if scale == self._noise_scale:
            return
        self._noise_scale = scale
        self.matcher = noisier_matcher(self.config.point_to_line, scale)

    def match(
        self,
        points_base: FloatArray,
        is_static: BoolArray,
        start: MotionState,
        kernel_factor: float = 1.0,
        is_valid: BoolArray | None = None,
    ) -> tuple[MatchResult, MotionState]:
        """Match the static points (n, 2) of the scan from a predicted state; that comes back where it fails.

        A match with which most of the scan's returns agree may contradict the prediction: the covariance of the motion
        is stretched as Student's t asks for. Where fewer agree than usual, the prediction may be wrong, and with it
        what was called moving there: all returns (`is_valid`) are matched from other starts. Where no pose is agreed by
        most of them, much of what the laser sees moves, and what pulls away from the prediction may move too: it holds,
        and the covariance of the match is stretched.

        A match with a narrower kernel that fails is made again with the usual one.
        """
        is_valid = is_static if is_valid is None else is_valid
        if self._elsewhere is None:
            self.is_adrift = bool(np.trace(start.cov_motion[:2, :2]) > 2.0 * self.config.adrift_m**2)
        start = state = self._elsewhere or start
        self._static_share = float(np.count_nonzero(is_static) / max(int(np.count_nonzero(is_valid)), 1))
        matched = self._match_from(points_base, is_static, start, kernel_factor)
        if kernel_factor == 1.0:
            is_static, matched = self._without_company(points_base, is_static, matched, start)
            matched, state = self._against_prediction(points_base, is_static, is_valid, matched, start)
        match = matched[0]
        if match.status == "failed" and kernel_factor < 1.0:
            return self.match(points_base, is_static, start, is_valid=is_valid)
        _, T_local_base, cov_independent = matched
        if match.status == "failed":
            state = state._replace(T_local_base=T_local_base, cov_independent=cov_independent)
        else:
            state = MotionState(
                T_local_base,
                fuse(state.cov_prior, match),
                cov_independent,
                match.cov_correlated,
                state.cov_odometry,
                state.cov_motion,
            )
        if self._elsewhere is not None:
            match = replace(match, contradicts_odometry=True)
        walks_along = None if self._company is None else self._company.walks_along
        if walks_along is not None and match.status != "failed":
            match = replace(match, walks_along=walks_along)
        self._latest = match
        return match, state

    def is_agreed(self, match: MatchResult) -> bool:
        """Tell whether most of the latest scan's returns agree with its match."""
        return self.agreement(match) >= self.config.min_agreement

    def agreement(self, match: MatchResult) -> float:
        """Share of the scan's returns that agree with a match; those called moving do not."""
        return self._static_share * match.inlier_ratio

    def agreement_at(self, points_base: FloatArray, is_used: BoolArray, T_local_base: FloatArray) -> float:
        """Share of the points (n, 2) of the scan that agrees with the local map where it is put, at a pose (3,)."""
        held = MatchPrior(T_a_base=T_local_base, cov=_HELD_COV, cov_independent=_HELD_COV)
        matcher = matcher_failing_below(self.config.point_to_line, 0.0)
        return matcher.match(self.local_map, points_base, is_used, self.laser_base, held).result.inlier_ratio

    @property
    def is_elsewhere(self) -> bool:
        """Whether the latest scan was matched from another start than the prediction, in all directions."""
        is_determined = self._latest is not None and self._latest.status == "converged"
        return is_determined and self._elsewhere is not None

    def is_supported(self, match: MatchResult) -> bool:
        """Tell whether enough returns tell of the direction in which a match differs from its prediction."""
        is_likely = match.status == "failed" or match.nis < self.config.min_tail_nis
        return is_likely or self._is_told(match, match.innovation)

    def is_unsure(self, match: MatchResult, doubt: FloatArray) -> bool:
        """Tell whether too few returns tell of the way in a direction (2,) in which it is in doubt, body frame."""
        return bool(doubt.any()) and not self._is_told(match, np.append(doubt, 0.0))

    def _is_told(self, match: MatchResult, direction: FloatArray) -> bool:
        """Down a bare corridor all but a few agree with any pose along it; those may be on who walks ahead."""
        arms = direction * (1.0, 1.0, self.config.tail_lever_m)
        told = direction @ match.told_share(self.config.point_to_line.residual_std_m) @ direction
        return bool(told >= self.config.min_tail_share * (arms @ arms))

    def _against_prediction(
        self,
        points_base: FloatArray,
        is_static: BoolArray,
        is_valid: BoolArray,
        matched: Match,
        start: MotionState,
    ) -> tuple[Match, MotionState]:
        """Let a match that most returns agree with contradict the prediction."""
        if self._is_doubtful(matched[0]):
            elsewhere = self._match_elsewhere(points_base, is_valid, matched[0], start)
            if elsewhere is not None and not self._is_believed(
                points_base, is_valid, start, elsewhere.T_local_base, self.config.agreement_gain
            ):
                elsewhere = None
            if elsewhere is None:
                needed = self.config.adrift_share * self._usual_agreement
                if self.is_adrift and self.agreement(matched[0]) < needed:
                    strict = matcher_failing_below(self.config.point_to_line, needed)
                    return self._match_from(points_base, is_static, start, matcher=strict), start
                return self._held(points_base, is_static, matched, start), start
            self._elsewhere, self._static_share = elsewhere, 1.0
            return self._match_from(points_base, is_valid, elsewhere), elsewhere
        scale = self._tail_scale(matched[0], start)
        if scale > self.config.min_tail_scale and self.is_supported(matched[0]):
            loosened = start.loosened((scale - 1.0) * start.cov_motion)
            second = self._match_from(points_base, is_static, loosened)
            needed = min(self.config.min_agreement, self.agreement(matched[0]) + self.config.tail_gain)
            if self.agreement(second[0]) >= needed and self._is_believed(
                points_base, is_static, start, second[1]
            ):
                return second, loosened
        if matched[0].nis > UNLIKELY_NIS and not self._is_believed(points_base, is_static, start, matched[1]):
            return self._held(points_base, is_static, matched, start), start
        return matched, start

    def _is_believed(
        self,
        points_base: FloatArray,
        is_used: BoolArray,
        start: MotionState,
        T_matched: FloatArray,
        gain: float = -1.0,
    ) -> bool:
        """Tell whether a match (3,) is believed against the odometry.

        More than a share of the returns speak for it, which is in reach, and do not ride along; or few for the other.
        """
        T_told = start.T_local_base
        if self._company is None or not self._recent.has_odometry:
            return True
        support = self._company.support(self.local_map, points_base, is_used, T_told, T_matched)
        is_reached = not self._recent.is_out_of_reach(T_told, T_matched)
        if support.is_proof or (is_reached and not support.rides_along and support.gained_share > gain):
            return True
        least = self.config.astray_share * self._usual_agreement
        return self.agreement_at(points_base, is_used, T_told) < least

    def _held(
        self, points_base: FloatArray, is_static: BoolArray, matched: Match, start: MotionState
    ) -> Match:
        """Let the prediction hold against a match that is unlikely and that fewer returns agree with than usual.

        Its noise is stretched until it is likely, as that of the motion is where most returns agree.
        """
        match = matched[0]
        if not self._recent.has_odometry or match.status == "failed" or match.nis <= UNLIKELY_NIS:
            return matched
        scale = self._noise_scale * math.sqrt(match.nis / MEAN_NIS)
        return self._match_from(
            points_base, is_static, start, matcher=noisier_matcher(self.config.point_to_line, scale)
        )

    def _without_company(
        self, points_base: FloatArray, is_static: BoolArray, matched: Match, start: MotionState
    ) -> tuple[BoolArray, Match]:
        """Leave out small things that alone pull the match or tell of a way in doubt; gives the points used."""
        company, match = self._company, matched.result
        if company is None or not self._recent.has_odometry or match.status == "failed":
            return is_static, matched
        config, company.walks_along = company.config, None
        is_unsure = self.is_unsure(match, start.doubt)
        if not (is_unsure or match.nis >= config.min_nis):
            return is_static, matched
        is_suspect = company.suspects(self.local_map, points_base, is_static, matched.T_a_base)
        if is_suspect is None:
            return is_static, matched
        rest = is_static & ~is_suspect
        without = self._match_from(points_base, rest, start)
        is_company = is_unsure and without.result.status != "failed"
        if not is_company and company.is_likely(match, without.result, self._static_share):
            there = self.agreement_at(points_base, rest, matched.T_a_base)
            is_company = there <= without.result.inlier_ratio + config.agreement_margin
        if not is_company:
            return is_static, matched
        company.walks_along = is_suspect
        if not (is_unsure or company.is_crowd(self._static_share)):
            poses = matched.T_a_base, without.T_a_base
            company.walks_along = company.pulling(self.local_map, points_base, is_suspect, *poses)
        return rest, without

    def _match_from(
        self,
        points_base: FloatArray,
        is_used: BoolArray,
        start: MotionState,
        kernel_factor: float = 1.0,
        matcher: Matcher[LocalMap] | None = None,
    ) -> Match:
        """Match from a start, by another matcher than the usual one if there is."""
        prior = MatchPrior(
            T_a_base=start.T_local_base, cov=start.cov_prior, cov_independent=start.cov_independent
        )
        return (matcher or self.matcher).match(
            self.local_map, points_base, is_used, self.laser_base, prior, kernel_factor=kernel_factor
        )

    def _tail_scale(self, match: MatchResult, state: MotionState) -> float:
        """How far the covariance of the latest motion must be stretched for the match to be likely."""
        if match.status == "failed" or match.nis < self.config.min_tail_nis:
            return 1.0
        return heavy_tail_scale(
            match.innovation, state.cov_prior, match.cov, state.cov_motion, self.config.motion_dof
        )

    def _is_doubtful(self, match: MatchResult) -> bool:
        """Tell whether so few returns agree that the prediction may have led astray."""
        if match.status == "failed":
            return True
        return self.agreement(match) < self.config.usual_share * self._usual_agreement

    def _match_elsewhere(
        self, points_base: FloatArray, is_valid: BoolArray, doubtful: MatchResult, start: MotionState
    ) -> MotionState | None:
        """Match all returns from other starts; where hardly any agree, from a full circle of them.

        Gives the best pose as a start with a wide covariance; None where that is not agreed, or nothing is better.
        Where hardly any agree with the prediction, and much of what is seen is new, as at the start of a spin, a pose
        is believed as well that leads by far. Down a bare corridor no pose is determined, but the heading is.
        """
        wide = self.config.lost_cov
        anywhere = start.loosened(wide)._replace(cov_prior=wide, cov_independent=wide)
        agreement, usual = self.agreement(doubtful), self._usual_agreement
        needed = max(agreement + self.config.agreement_gain, self.config.min_agreement)
        most_m, most_rad = self._farthest(start)
        reach_rad = min(self.config.turn_reach * math.sqrt(start.cov_prior[2, 2]), math.pi)
        step_rad = self.config.turn_step_rad
        rounds = [self._recent.starts() + turned_starts(start.T_local_base, step_rad, 0.0, reach_rad)]
        is_astray = not self.is_adrift and agreement < self.config.astray_share * usual
        if self.is_adrift:
            needed = max(needed, self.config.adrift_share * usual)
            std_m = math.sqrt(np.trace(start.cov_motion[:2, :2]))
            shifted = self._best_shifted(points_base, is_valid, anywhere, std_m)
            rounds = [[*rounds[0], *turned_starts(start.T_local_base, step_rad, reach_rad, math.pi), shifted]]
        elif is_astray:
            rounds.append(turned_starts(start.T_local_base, step_rad, reach_rad, math.pi))
        found, sliding = list[tuple[float, FloatArray]](), list[tuple[float, FloatArray]]()
        for starts in rounds:
            for T in starts:
                match, T_found, _ = self._match_from(points_base, is_valid, anywhere._replace(T_local_base=T))
                way_m, turn_rad = se2.distance(self._recent.T_local_before, T_found)
                if match.status != "failed" and way_m <= most_m and turn_rad <= most_rad:
                    (found if match.status == "converged" else sliding).append((match.inlier_ratio, T_found))
            best = max(found, key=itemgetter(0), default=None)
            if best is not None and best[0] > needed:
                return anywhere._replace(T_local_base=best[1])
        if best is not None and is_astray and leads(best, found, agreement, usual, self.config):
            return anywhere._replace(T_local_base=best[1])
        turned = max(sliding, key=itemgetter(0), default=None)
        if turned is None or turned[0] <= needed or self.is_adrift or not self._recent.has_odometry:
            return None
        T = np.append(start.T_local_base[:2], turned[1][2])
        return self._turned_back(points_base, is_valid, start, anywhere._replace(T_local_base=T), needed)

    def _turned_back(
        self,
        points_base: FloatArray,
        is_valid: BoolArray,
        start: MotionState,
        turned: MotionState,
        needed: float,
    ) -> MotionState | None:
        """Take back a turn that the odometry made up, down a bare corridor, where no match is determined.

        The way along is still the odometry's, as uncertain as wheels that slip make it.
        """
        match, T, _ = self._match_from(points_base, is_valid, turned)
        if match.status == "failed" or match.inlier_ratio <= needed:
            return None
        offset = np.abs(se2.between(start.T_local_base, T))
        offset[:2] += self.config.slip_lever_m * offset[2]
        return start.loosened(np.diag(offset**2))._replace(T_local_base=T)

    def _farthest(self, start: MotionState) -> tuple[float, float]:
        """How far the robot can be [m, rad] from where it was at the scan before: about as far as told, or as lately.

        What rises before a robot that tilts looks like the wall behind it, metres nearer, or like one beside it.
        """
        if self.is_adrift:
            return math.inf, math.inf
        way_m, turn_rad = self._recent.farthest(start.T_local_base)
        return self.config.adrift_m + way_m, self.config.lost_std_rad + turn_rad

    def _best_shifted(
        self, points_base: FloatArray, is_valid: BoolArray, start: MotionState, std_m: float
    ) -> FloatArray:
        """Where some of the returns agree best of all places that the robot may be at, in all headings."""
        some, matcher = some_of(is_valid), matcher_failing_below(self.config.point_to_line, 0.0)
        config, best, T_best = self.config, 0.0, start.T_local_base
        reach_m = min(config.shift_reach * std_m, config.lost_std_m)
        for T in shifted_starts(start.T_local_base, config.adrift_m, reach_m, config.turn_step_rad):
            match, T_found, _ = self._match_from(
                points_base, some, start._replace(T_local_base=T), matcher=matcher
            )
            if match.inlier_ratio > best:
                best, T_best = match.inlier_ratio, T_found
        return T_best
