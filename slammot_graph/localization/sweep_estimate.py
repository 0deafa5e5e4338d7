"""The velocity during a sweep, estimated with the pose: what brings all parts of a scan onto the local map.

The motion model's velocity is the prior. With the pose open too, the velocity is solved by Gauss-Newton on the pairs of
the latest match; what stays unknown of it makes the pose at the stamp less certain.
"""

from dataclasses import replace

import numpy as np

from slammot_graph.core.linalg import invert
from slammot_graph.core.results import MatchResult
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
        gain = np.linalg.solve(h[:3, :3], h[:3, 3:])
        cov_velocity = np.linalg.inv(h[3:, 3:] - h[3:, :3] @ gain)
        cov_velocity = 0.5 * (cov_velocity + cov_velocity.T)
        step = -cov_velocity @ (g[3:] - gain.T @ g[:3])
        self.velocity = self.velocity + step
        self.cov_pose = gain @ cov_velocity @ gain.T
        reach_s = max(self.prior.last_s - self.prior.first_s, abs(self.prior.last_s))
        self._is_done = bool(reach_s * np.abs(step * (1.0, 1.0, LEVER_M)).max() < SAME_M)
        return self.prior.corrected(self.velocity, cov_velocity)

    def widened(self, match: MatchResult, state: MotionState) -> tuple[MatchResult, MotionState]:
        """Give a match and the state after it, less certain by what is not known of the velocity."""
        if match.status == "failed" or not self._n_rounds:
            return match, state
        extra = self.cov_pose
        match = replace(
            match,
            cov=match.cov + extra,
            information=_less(match.information, extra),
            graph_information=_less(match.graph_information, extra),
        )
        return match, state._replace(
            cov_prior=state.cov_prior + extra, cov_independent=state.cov_independent + extra
        )


def _less(information: FloatArray, extra: FloatArray) -> FloatArray:
    """(3, 3) information of what has an extra covariance (3, 3); the information may be singular."""
    less = np.linalg.solve(np.eye(3) + information @ extra, information)
    return np.asarray(0.5 * (less + less.T))
