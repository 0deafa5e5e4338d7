"""How the robot moves during a sweep, by what its motion model knows: what a scan with beam times is deskewed by."""

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.odometry_track import OdometryTrack
from slammot_graph.core.scan import Scan
from slammot_graph.core.sweep import SweepMotion
from slammot_graph.core.types import FloatArray
from slammot_graph.odometry.noise import ConstantNoise, OdometryNoise

N_KNOTS = 9
"""Times at which the motion during a sweep is asked for."""

MIN_SWEEP_S = 1e-4
"""A shorter sweep counts as this long where its velocity is asked for."""


def beam_times_of(scan: Scan) -> FloatArray:
    """(n,) beam times of a scan that has them [s]."""
    if scan.beam_times is None:
        raise ValueError(f"scan {scan.index} has no beam times")
    return scan.beam_times


def knot_times(beam_times: FloatArray) -> FloatArray:
    """(m,) times from the first beam to the last one [s]."""
    return np.linspace(float(beam_times.min()), float(beam_times.max()), N_KNOTS)


def sweep_at_velocity(times_s: FloatArray, velocity: FloatArray, cov_velocity: FloatArray) -> SweepMotion:
    """Give the motion at a constant velocity (3,) (body frame, per s) with its covariance (3, 3).

    Parameters
    ----------
    times_s : (m,) array
        Of the knots since the stamp [s].
    """
    T = se2.exp(times_s[:, None] * velocity)
    T[:, 2] = times_s * velocity[2]
    return SweepMotion(
        first_s=float(times_s[0]), last_s=float(times_s[-1]), T_stamp_base=T, cov_velocity=cov_velocity
    )


def sweep_along(times_s: FloatArray, T_stamp_base: FloatArray, cov_motion: FloatArray) -> SweepMotion:
    """Give the motion along poses (m, 3) at the knots; `cov_motion` (3, 3) is that of the motion over the sweep."""
    duration_s = max(float(times_s[-1] - times_s[0]), MIN_SWEEP_S)
    return SweepMotion(
        first_s=float(times_s[0]),
        last_s=float(times_s[-1]),
        T_stamp_base=T_stamp_base,
        cov_velocity=cov_motion / duration_s**2,
    )


def relative_poses(T_a_stamp: FloatArray, T_a_base: FloatArray) -> FloatArray:
    """(m, 3) poses in the frame of another one (3,); theta is not wrapped."""
    c, s = np.cos(T_a_stamp[2]), np.sin(T_a_stamp[2])
    dx, dy, turn = (T_a_base - T_a_stamp).T
    return np.stack([c * dx + s * dy, -s * dx + c * dy, turn], axis=-1)


def sweep_by_track(
    times_s: FloatArray, stamp: float, track: OdometryTrack, noise: OdometryNoise | ConstantNoise
) -> SweepMotion:
    """Give the motion by odometry as it is, around a stamp."""
    at = np.append(stamp, stamp + times_s)
    poses = np.stack([np.interp(at, track.stamps, track.T_odom_base[:, k]) for k in range(3)], axis=-1)
    T = relative_poses(poses[0], poses[1:])
    return sweep_along(times_s, T, noise.covariance(relative_poses(T[0], T[-1:])[0]))
