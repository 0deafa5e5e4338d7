"""A differential-drive robot that follows waypoints, and its imperfect odometry."""

from dataclasses import dataclass, fields

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.types import FloatArray
from slammot_graph.simulation import _drive_kernels

_ROUTE_STEP_M = 0.05


@dataclass(frozen=True, kw_only=True)
class DriveConfig:
    """How the robot drives.

    Attributes
    ----------
    max_speed_m_s, max_turn_rad_s : float
        Bounds of the velocities.
    max_accel_m_s2, max_turn_accel_rad_s2 : float
        Bounds of the accelerations.
    lookahead_m : float
        The robot heads for the point this far ahead on its route.
    rest_start_s, rest_end_s : float
        It stands this long before and after the drive.
    speed_spread : float
        Each drive's `max_speed_m_s` is scaled by a uniform draw from 1 -+ this.
    route_jitter_m : float
        Inner waypoints move by a uniform draw of -+ this along each axis.
    """

    max_speed_m_s: float = 0.5
    max_turn_rad_s: float = 0.9
    max_accel_m_s2: float = 0.5
    max_turn_accel_rad_s2: float = 2.0
    lookahead_m: float = 0.45
    rest_start_s: float = 1.0
    rest_end_s: float = 1.0
    speed_spread: float = 0.1
    route_jitter_m: float = 0.08

    def __post_init__(self) -> None:
        for key in (
            "max_speed_m_s",
            "max_turn_rad_s",
            "max_accel_m_s2",
            "max_turn_accel_rad_s2",
            "lookahead_m",
        ):
            if not 0.0 < getattr(self, key) < np.inf:
                raise ConfigError(f"drive: {key} must be positive, not {getattr(self, key):g}")
        for key in ("rest_start_s", "rest_end_s", "route_jitter_m"):
            if not 0.0 <= getattr(self, key) < np.inf:
                raise ConfigError(f"drive: {key} must be zero or positive, not {getattr(self, key):g}")
        if not 0.0 <= self.speed_spread < 1.0:
            raise ConfigError(f"drive: speed_spread must lie in [0, 1), not {self.speed_spread:g}")


@dataclass(frozen=True, kw_only=True)
class OdometryNoise:
    """What is wrong with the wheels: errors of a whole log, noise that grows with motion, and slips.

    The noise is a random walk, so its variance after a given motion does not depend on the laser's rate.
    Systematic errors are drawn once per log from centred Gaussians.

    Attributes
    ----------
    scale_std : float
        Relative error of distances (one draw per log).
    turn_scale_std : float
        Relative error of turns (one draw per log).
    bias_std_rad_per_m : float
        Turn that is reported per metre driven (one draw per log).
    xy_std_per_sqrt_m : float
        Noise along and across, after 1 m [m].
    xy_std_per_sqrt_rad : float
        Noise along and across, after a turn of 1 rad [m].
    theta_std_per_sqrt_m : float
        Noise of the heading, after 1 m [rad].
    theta_std_per_sqrt_rad : float
        Noise of the heading, after a turn of 1 rad [rad].
    slips_per_m : float
        Expected number of wheel slips per metre driven.
    slip_std_m, slip_std_rad : float
        Size of a slip: along the motion, and of the heading.
    """

    scale_std: float = 0.01
    turn_scale_std: float = 0.015
    bias_std_rad_per_m: float = 0.006
    xy_std_per_sqrt_m: float = 0.01
    xy_std_per_sqrt_rad: float = 0.005
    theta_std_per_sqrt_m: float = 0.01
    theta_std_per_sqrt_rad: float = 0.02
    slips_per_m: float = 0.05
    slip_std_m: float = 0.03
    slip_std_rad: float = 0.03

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if not 0.0 <= value < np.inf:
                raise ConfigError(f"odometry noise: {item.name} must be zero or positive, not {value:g}")


@dataclass(frozen=True, kw_only=True, eq=False)
class OdometryErrors:
    """The errors that one log really has.

    Attributes
    ----------
    scale, turn_scale, bias_rad_per_m : float
        The systematic errors drawn.
    slip_scans : (k,) int array
        Scans before which a wheel slipped.
    """

    scale: float
    turn_scale: float
    bias_rad_per_m: float
    slip_scans: np.ndarray[tuple[int], np.dtype[np.int64]]


def drive(
    route: FloatArray,
    config: DriveConfig,
    period_s: float,
    rng: np.random.Generator,
    *,
    is_dense: bool = False,
) -> FloatArray:
    """Drive along waypoints.

    Parameters
    ----------
    route : (m, 2) array
        Waypoints [m], world frame.
    config : DriveConfig
    period_s : float
        Time between poses [s].
    rng : numpy.random.Generator
        For the drive's speed and the waypoints' jitter.
    is_dense : bool
        Give all poses that the drive is computed by, `poses_per_period` for each period.

    Returns
    -------
    (n, 3) array
        True poses, base in world, from the first waypoint to the last.

    Raises
    ------
    ConfigError
        Fewer than two different waypoints, or a drive that does not arrive.
    """
    speed = config.max_speed_m_s * rng.uniform(1.0 - config.speed_spread, 1.0 + config.speed_spread)
    points = np.array(route, dtype=np.float64)
    if points.ndim != 2 or points.shape[1:] != (2,) or len(points) < 2 or not np.ptp(points, axis=0).any():
        raise ConfigError("the robot's route needs at least two different waypoints")
    jitter = config.route_jitter_m * rng.uniform(-1.0, 1.0, points.shape)
    points[1:-1] += jitter[1:-1]
    dense = _dense(points)
    n_sub = poses_per_period(period_s)
    n_poses = n_sub if is_dense else 1
    length = _ROUTE_STEP_M * len(dense)
    n_rest = int(np.ceil(config.rest_start_s / period_s)), int(np.ceil(config.rest_end_s / period_s))
    n_max = int((4.0 * length / speed + 60.0 + 8.0 * len(points) / config.max_turn_rad_s) / period_s)
    poses = _drive_kernels.follow(
        dense,
        period_s / n_sub,
        n_sub // n_poses,
        n_poses * n_max,
        speed,
        config.max_turn_rad_s,
        config.max_accel_m_s2,
        config.max_turn_accel_rad_s2,
        config.lookahead_m,
    )
    if len(poses) == n_poses * n_max:
        raise ConfigError("the robot does not reach the end of its route; is it too slow or too stiff?")
    # a scan that is under way at the end is the last one
    n_after = n_poses * n_rest[1] + (-(len(poses) - 1)) % n_poses
    return np.concatenate(
        [np.repeat(poses[:1], n_poses * n_rest[0], 0), poses, np.repeat(poses[-1:], n_after, 0)]
    )


def poses_per_period(period_s: float) -> int:
    """Poses that a drive is computed by in each period [s]."""
    return max(1, int(np.ceil(period_s / 0.02)))


def simulate_odometry(
    T_world_base: FloatArray, noise: OdometryNoise, rng: np.random.Generator, *, noise_scale: float = 1.0
) -> tuple[FloatArray, OdometryErrors]:
    """Odometry of a drive, starting at the origin of `odom`.

    Parameters
    ----------
    T_world_base : (n, 3) array
        True poses.
    noise : OdometryNoise
    rng : numpy.random.Generator
        The number of draws depends on n alone.
    noise_scale : float
        Multiplies every error, also the slips' sizes; 0 gives exact odometry.

    Returns
    -------
    T_odom_base : (n, 3) array
    errors : OdometryErrors

    Raises
    ------
    ConfigError
        A negative or infinite `noise_scale`.
    """
    if not 0.0 <= noise_scale < np.inf:
        raise ConfigError(f"noise_scale must be zero or positive, not {noise_scale:g}")
    n_steps = len(T_world_base) - 1
    scale, turn_scale, bias = (
        noise_scale
        * rng.standard_normal(3)
        * (noise.scale_std, noise.turn_scale_std, noise.bias_std_rad_per_m)
    )
    draws = rng.standard_normal((n_steps, 3))
    slip_at, slip_size = rng.random(n_steps), rng.standard_normal((n_steps, 2))

    motion = se2.log(se2.between(T_world_base[:-1], T_world_base[1:]))
    distance, turn = np.hypot(motion[:, 0], motion[:, 1]), np.abs(motion[:, 2])
    xy_std = np.sqrt(noise.xy_std_per_sqrt_m**2 * distance + noise.xy_std_per_sqrt_rad**2 * turn)
    theta_std = np.sqrt(noise.theta_std_per_sqrt_m**2 * distance + noise.theta_std_per_sqrt_rad**2 * turn)
    is_slip = slip_at < -np.expm1(-noise.slips_per_m * distance)

    reported = motion.copy()
    reported[:, :2] *= 1.0 + scale
    reported[:, 2] += turn_scale * motion[:, 2] + bias * distance
    reported += noise_scale * draws * np.column_stack([xy_std, xy_std, theta_std])
    slips = np.column_stack([noise.slip_std_m * slip_size[:, 0], noise.slip_std_rad * slip_size[:, 1]])
    reported[:, [0, 2]] += noise_scale * np.where(is_slip[:, None], slips, 0.0)

    odometry = accumulate(se2.exp(reported))
    errors = OdometryErrors(
        scale=float(scale),
        turn_scale=float(turn_scale),
        bias_rad_per_m=float(bias),
        slip_scans=np.flatnonzero(is_slip).astype(np.int64) + 1,
    )
    return odometry, errors


def _dense(points: FloatArray) -> FloatArray:
    """Points every `_ROUTE_STEP_M` along a polyline."""
    steps = np.hypot(*np.diff(points, axis=0).T)
    points = points[np.concatenate([[True], steps > 1e-9])]
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    at = np.linspace(0.0, along[-1], max(2, int(np.ceil(along[-1] / _ROUTE_STEP_M)) + 1))
    return np.column_stack([np.interp(at, along, points[:, 0]), np.interp(at, along, points[:, 1])])


def accumulate(increments: FloatArray) -> FloatArray:
    """Poses (n + 1, 3) from the origin along n increments."""
    theta = np.concatenate([[0.0], np.cumsum(increments[:, 2])])
    c, s = np.cos(theta[:-1]), np.sin(theta[:-1])
    x = np.cumsum(c * increments[:, 0] - s * increments[:, 1])
    y = np.cumsum(s * increments[:, 0] + c * increments[:, 1])
    return np.column_stack([np.append(0.0, x), np.append(0.0, y), se2.wrap_angle(theta)])
