"""Lost detection: matches that fail in a row, and robots that may have been kidnapped while they saw nothing."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.events import PREDICTED_CAUSES
from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.types import FloatArray


@dataclass(frozen=True, kw_only=True)
class Loss:
    """Why the robot is taken for lost, and after how many scans."""

    cause: Literal["failed matches", "changing view", "kidnapped", "blind drive", "gap"]
    n_scans: int

    @property
    def is_known(self) -> bool:
        """Whether the prediction goes on: only the local map cannot be used any more."""
        return self.cause in PREDICTED_CAUSES


class LostDetector:
    """Counts failed matches and scans with nothing in sight.

    Attributes
    ----------
    n_lost : int
        So many in a row mean that the robot is lost.
    kidnapped_distance_m : float
        A robot whose odometry moved less than this while it saw nothing may have been kidnapped.
    n_failed : int
        Matches that failed in a row, save those without enough points.
    n_blind : int
        Scans in a row with nothing in sight.
    """

    def __init__(self, n_lost: int, kidnapped_distance_m: float) -> None:
        self.n_lost = n_lost
        self.kidnapped_distance_m = kidnapped_distance_m
        self.n_failed = 0
        self.n_blind = 0
        self._n_standing_out = 0
        self._T_odom_matched: FloatArray = se2.IDENTITY
        self._T_odom_seen: FloatArray = se2.IDENTITY

    def update(
        self,
        match: MatchResult | None,
        T_odom_base: FloatArray,
        *,
        has_points: bool,
        has_local_map: bool,
        has_odometry: bool = False,
        is_adrift: bool = False,
        stands_out: bool = False,
    ) -> Loss | None:
        """Take in the next scan; tells if the robot is lost now.

        Parameters
        ----------
        match : MatchResult or None
        T_odom_base : (3,) array
            Dead-reckoned pose.
        has_points : bool
            Enough for a match.
        has_local_map : bool
            There was something to match onto.
        has_odometry : bool
            The dead-reckoned pose comes from wheels, which tell of the way also where nothing is seen.
        is_adrift : bool
            The prediction knows so little of the place that what failed here cannot go on from it.
        stands_out : bool
            The match failed, yet more of the scan agrees at the predicted pose than at others: see `chance_agreement`.
        """
        has_failed = match is not None and match.status == "failed"
        if match is not None and has_failed:
            self.n_failed += has_points
            self._n_standing_out += has_points and stands_out
        else:
            self.n_failed = self._n_standing_out = 0
            self._T_odom_matched = T_odom_base
        loss = None
        if has_points and has_local_map and self._may_be_kidnapped(T_odom_base, has_failed):
            is_blind_drive = has_odometry and self._has_driven(self._T_odom_seen, T_odom_base)
            loss = Loss(cause="blind drive" if is_blind_drive else "kidnapped", n_scans=self.n_blind)
        elif has_failed and has_points and is_adrift:
            loss = Loss(cause="gap", n_scans=1)
        elif self.n_failed >= self.n_lost:
            # a robot that stands gives the same scan again and again, which tells as little as one
            # without odometry the prediction may be as wrong as the match: hardly a scan may speak against it
            least = self.n_lost // 2 + 1 if has_odometry else self.n_lost - 1
            is_predicted = self._n_standing_out >= least and self._has_driven(
                self._T_odom_matched, T_odom_base
            )
            loss = Loss(cause="changing view" if is_predicted else "failed matches", n_scans=self.n_lost)
        if loss is not None:
            self.n_failed = self._n_standing_out = 0
            self._T_odom_matched = T_odom_base
        if has_points:
            self.n_blind, self._T_odom_seen = 0, T_odom_base
        else:
            self.n_blind += 1
        return loss

    def _may_be_kidnapped(self, T_odom_base: FloatArray, has_failed: bool) -> bool:
        """Tell whether the robot may have been moved while it saw nothing.

        Who kidnaps a robot occludes its laser, and its wheels stand still: then even a good match proves nothing.
        """
        if self.n_blind < self.n_lost:
            return False
        return not self._has_driven(self._T_odom_seen, T_odom_base) or has_failed

    def _has_driven(self, T_odom_before: FloatArray, T_odom_base: FloatArray) -> bool:
        """Tell whether the robot has driven farther than who is kidnapped."""
        return bool(np.hypot(*se2.between(T_odom_before, T_odom_base)[:2]) >= self.kidnapped_distance_m)
