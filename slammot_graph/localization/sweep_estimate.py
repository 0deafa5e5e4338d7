"""The velocity during a sweep, estimated with the pose: what brings all parts of a scan onto the local map.

The motion model's velocity is the prior. With the pose open too, the velocity is solved by Gauss-Newton on the pairs of
the latest match; what stays unknown of it makes the pose at the stamp less certain. A sweep ends where the next one
begins: by a Kalman update both are joined there.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from slammot_graph.core import se2
from slammot_graph.core.linalg import invert
from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.scan import Scan
from slammot_graph.core.sweep import SweepMotion
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.mapping.local_map import LocalMap
from slammot_graph.odometry.propagation import MotionState
from slammot_graph.registration._sweep_kernels import accumulate_sweep
from slammot_graph.registration.point_to_line import PointToLineConfig

MAX_ROUNDS = 4
"""How often the velocity is solved for, with a match in between."""

SAME_M = 0.003
"""A velocity that moves the end points by less is as good as the one before [m], at `LEVER_M`."""

LEVER_M = 4.0

ACCELERATION_STD: FloatArray = np.array([1.0, 1.0, 3.0])
"""Of the base where no beam tells of its motion [m/s^2, m/s^2, rad/s^2]."""

MAX_GAP = 0.7
"""Sweeps are joined over a pause of no more than this share of a sweep."""

MAX_NIS = 16.0
"""A pose that contradicts the end of the sweep before by more is not joined to it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SweepEnd:
    """Where a sweep ended: from there its motion goes on for a while.

    Attributes
    ----------
    stamp : float
        Of the scan [s].
    T_local_base : (3,) array
        At the stamp.
    sweep : SweepMotion
    cov : (6, 6) array
        Of pose and velocity, right perturbation (body frame at the stamp).
    """

    stamp: float
    T_local_base: FloatArray
    sweep: SweepMotion
    cov: FloatArray

    def at(self, stamp: float) -> tuple[FloatArray, FloatArray] | None:
        """Pose (3,) at the stamp of the next sweep with its covariance (3, 3) (body frame); None: too late."""
        after_s, sweep = stamp - self.stamp, self.sweep
        duration_s = sweep.last_s - sweep.first_s
        pause_s = after_s - sweep.last_s
        if not abs(pause_s) <= MAX_GAP * duration_s:
            return None
        gone_s = max(pause_s, 0.0)
        T_stamp_next = sweep.at(np.array([min(after_s, sweep.last_s)]))[0]
        T_stamp_next = se2.compose(T_stamp_next, se2.exp(gone_s * sweep.velocity))
        move = np.hstack([np.eye(3), after_s * np.eye(3)])
        back = se2.adjoint(se2.inverse(T_stamp_next))
        cov = back @ move @ self.cov @ move.T @ back.T
        cov += np.diag((0.5 * gone_s * (gone_s + duration_s) * ACCELERATION_STD) ** 2)
        return se2.compose(self.T_local_base, T_stamp_next), cov


class SweepEstimate:
    """The motion during the sweep of one scan.

    Parameters
    ----------
    prior : SweepMotion
        By the motion model.
    config : PointToLineConfig

    Attributes
    ----------
    velocity : (3,) array
        Added to that of the prior so far, base frame at the stamp.
    cov_pose : (3, 3) array
        What the open velocity adds to the covariance of the pose at the stamp, right perturbation (body frame).
    """

    def __init__(self, prior: SweepMotion, config: PointToLineConfig) -> None:
        self.prior = prior
        self.config = config
        self.velocity: FloatArray = np.zeros(3)
        self.cov_pose: FloatArray = np.zeros((3, 3))
        self._gain: FloatArray = np.zeros((3, 3))
        self._cov_velocity: FloatArray = prior.cov_velocity
        self._matched: tuple[MatchResult, MotionState]
        self._n_rounds = 0
        self._is_done = False

    def improved(
        self,
        scan: Scan,
        is_static: BoolArray,
        local_map: LocalMap,
        T_local_base: FloatArray,
        cov_prior: FloatArray,
    ) -> SweepMotion | None:
        """Give the motion by the deskewed scan (n beams) at its matched pose; None where it stays as it is.

        Parameters
        ----------
        scan : Scan
        is_static : (n,) bool array
        local_map : LocalMap
        T_local_base : (3,) array
            The matched pose.
        cov_prior : (3, 3) array
            Of the predicted pose (body frame).
        """
        if self._is_done or self._n_rounds == MAX_ROUNDS or scan.beam_times is None:
            return None
        self._n_rounds += 1
        config = self.config
        h, g = np.empty((6, 6)), np.empty(6)
        accumulate_sweep(
            local_map.points,
            local_map.normals,
            local_map.nearest,
            local_map.inv_cell,
            local_map.first,
            scan.points_base(),
            is_static,
            scan.origins_base,
            scan.beam_times,
            T_local_base,
            local_map.config.reach_m**2,
            config.kernel_scale_m**2,
            config.point_weight,
            h,
            g,
        )
        h /= config.residual_std_m**2
        g /= config.residual_std_m**2
        prior_information = invert(self.prior.cov_velocity)
        h[:3, :3] += invert(cov_prior)
        h[3:, 3:] += prior_information
        g[3:] += prior_information @ self.velocity
        gain: FloatArray = np.linalg.solve(h[:3, :3], h[:3, 3:]).astype(np.float64)
        cov_velocity = _symmetric(np.linalg.inv(h[3:, 3:] - h[3:, :3] @ gain))
        step = -cov_velocity @ (g[3:] - gain.T @ g[:3])
        self.velocity = self.velocity + step
        self.cov_pose = gain @ cov_velocity @ gain.T
        self._gain, self._cov_velocity = gain, cov_velocity
        reach_s = max(self.prior.last_s - self.prior.first_s, abs(self.prior.last_s))
        self._is_done = bool(reach_s * np.abs(step * (1.0, 1.0, LEVER_M)).max() < SAME_M)
        return self.prior.corrected(self.velocity, cov_velocity)

    def widened(self, match: MatchResult, state: MotionState) -> tuple[MatchResult, MotionState]:
        """Give a match and the state after it, less certain by what is not known of the velocity."""
        self._matched = match, state
        if match.status == "failed" or not self._n_rounds:
            return match, state
        return _widened(match, state, self.cov_pose)

    def joined(
        self, scan: Scan, before: SweepEnd | None
    ) -> tuple[Scan, MatchResult, MotionState, SweepEnd | None]:
        """Join the sweep to the end of the one before, if there is any.

        Gives the scan, its latest match and the state with what that tells of pose and velocity, and where this sweep
        ends; None where the match failed.
        """
        match, state = self._matched
        if match.status == "failed" or not self._n_rounds:
            return scan, match, state, None
        gain: FloatArray = self._gain
        cov_velocity: FloatArray = self._cov_velocity
        sweep = self.prior if scan.sweep is None else scan.sweep
        ended = None if before is None else before.at(scan.stamp)
        step = np.zeros(6)
        if ended is not None:
            cov = np.vstack([state.cov_independent + gain @ cov_velocity @ gain.T, -cov_velocity @ gain.T])
            innovation = se2.log(se2.between(state.T_local_base, ended[0]))
            told = np.linalg.inv(cov[:3] + ended[1])
            if float(innovation @ told @ innovation) < MAX_NIS:
                step = cov @ told @ innovation
                cov_velocity = _symmetric(cov_velocity - cov[3:] @ told @ cov[3:].T)
                sweep = self.prior.corrected(self.velocity + step[3:], cov_velocity)
        pose_step, extra = se2.exp(step[:3]), gain @ cov_velocity @ gain.T
        match, state = _widened(match, state, extra)
        match = replace(match, T_ref_base=se2.compose(match.T_ref_base, pose_step))
        state = state._replace(T_local_base=se2.compose(state.T_local_base, pose_step))
        cross = -gain @ cov_velocity
        end = SweepEnd(
            stamp=scan.stamp,
            T_local_base=state.T_local_base,
            sweep=sweep,
            cov=np.block([[state.cov_independent, cross], [cross.T, cov_velocity]]),
        )
        return replace(scan, sweep=sweep), match, state, end


def _widened(match: MatchResult, state: MotionState, extra: FloatArray) -> tuple[MatchResult, MotionState]:
    """Give a match and the state after it with an extra covariance (3, 3) of the pose (body frame)."""
    match = replace(
        match,
        cov=match.cov + extra,
        information=_less(match.information, extra),
        graph_information=_less(match.graph_information, extra),
    )
    return match, state._replace(
        cov_prior=state.cov_prior + extra, cov_independent=state.cov_independent + extra
    )


def _symmetric(cov: npt.NDArray[Any]) -> FloatArray:
    return np.asarray(0.5 * (cov + cov.T), dtype=np.float64)


def _less(information: FloatArray, extra: FloatArray) -> FloatArray:
    """(3, 3) information of what has an extra covariance (3, 3); the information may be singular."""
    less = np.linalg.solve(np.eye(3) + information @ extra, information)
    return _symmetric(less)
