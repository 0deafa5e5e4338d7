"""Faults of odometry: a simulated log in, the same log with odometry that is late, scaled, slipping or dead out.

Laser, people and truth stay as they are. What the wheels told already, with their noise, is what a fault changes.
"""

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError, InputError
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.simulation.log import SimulatedLog
from slammot_graph.simulation.robot import accumulate


def late(log: SimulatedLog, delay_s: float) -> SimulatedLog:
    """Odometry that arrives late: a scan stamped t carries the odometry of ``t - delay_s``, interpolated linearly.

    Parameters
    ----------
    log : SimulatedLog
    delay_s : float
        Negative where the laser is the one that is late. Before the first and after the last pose that one is held.
    """
    if not np.isfinite(delay_s):
        raise ConfigError(f"the delay must be finite, not {delay_s:g} s")
    T, asked = _odometry(log), log.stamps - delay_s
    columns = (T[:, 0], T[:, 1], np.unwrap(T[:, 2]))
    x, y, theta = (np.interp(asked, log.stamps, column) for column in columns)
    return log.with_odometry(np.column_stack([x, y, se2.wrap_angle(theta)]))


def scaled(log: SimulatedLog, factor: float) -> SimulatedLog:
    """Odometry whose distances are too long by a factor; a negative one counts forward as backward."""
    return _changed(log, _increments(log) * [factor, factor, 1.0])


def turned(log: SimulatedLog, factor: float) -> SimulatedLog:
    """Odometry whose turns are too large by a factor; a negative one turns the wrong way."""
    return _changed(log, _increments(log) * [1.0, 1.0, factor])


def biased(log: SimulatedLog, rad_per_m: float) -> SimulatedLog:
    """Odometry that turns by so much with each metre driven: one wheel is larger than the other."""
    increments = _increments(log)
    increments[:, 2] += rad_per_m * np.hypot(increments[:, 0], increments[:, 1])
    return _changed(log, increments)


def slipping(
    log: SimulatedLog,
    *,
    forward_m_s: float = 0.4,
    turn_rad_s: float = 0.0,
    from_share: float = 0.4,
    duration_s: float = 1.0,
) -> SimulatedLog:
    """Wheels that slip for a while: the odometry counts motion that the robot does not make.

    Parameters
    ----------
    log : SimulatedLog
    forward_m_s, turn_rad_s : float
        Counted beyond the true motion.
    from_share : float
        Where the fault begins, as a share of the log's duration.
    duration_s : float
    """
    increments, is_faulty = _increments(log), _during(log, from_share, duration_s)
    step_s = np.diff(log.stamps)[is_faulty]
    increments[is_faulty] += step_s[:, None] * np.array([forward_m_s, 0.0, turn_rad_s])
    return _changed(log, increments)


def standing_still(log: SimulatedLog, *, from_share: float = 0.4, duration_s: float = 10.0) -> SimulatedLog:
    """Wheels that are dragged for a while: the odometry counts nothing though the robot moves, then goes on."""
    increments = _increments(log)
    increments[_during(log, from_share, duration_s)] = 0.0
    return _changed(log, increments)


def jumping(log: SimulatedLog, distance_m: float, *, at_share: float = 0.5) -> SimulatedLog:
    """Odometry that jumps forward by a distance in one step, for good."""
    increments = _increments(log)
    increments[int(_share(at_share) * len(increments)), 0] += distance_m
    return _changed(log, increments)


def leaping(log: SimulatedLog, distance_m: float, *, every: int = 20) -> SimulatedLog:
    """Odometry that jumps forward by a distance at each `every`-th scan, for good."""
    increments = _increments(log)
    increments[_count(every) - 1 :: every, 0] += distance_m
    return _changed(log, increments)


def spiking(log: SimulatedLog, distance_m: float, *, every: int = 20) -> SimulatedLog:
    """Odometry of which each `every`-th pose is off to the front by a distance, and no other."""
    T = _odometry(log).copy()
    T[_count(every) :: every] = se2.compose(T[every::every], np.array([distance_m, 0.0, 0.0]))
    return log.with_odometry(T)


def held(log: SimulatedLog, n_held: int = 2) -> SimulatedLog:
    """Odometry that stands still for `n_held` scans and then catches up in one leap, over and over."""
    k = np.arange(log.n_scans)
    return log.with_odometry(_odometry(log)[k - k % (_count(n_held) + 1)])


def unsigned(log: SimulatedLog, *, every_s: float = 10.0, duration_s: float = 1.5) -> SimulatedLog:
    """Odometry that counts the wrong direction now and then: backward where the robot drives forward.

    An encoder that does not tell the direction does this where a robot backs up; simulated robots drive forward only,
    so that it is done the other way about.

    Parameters
    ----------
    log : SimulatedLog
    every_s, duration_s : float
        The last `duration_s` of each `every_s` are counted backward.
    """
    if not 0.0 < duration_s < every_s < np.inf:
        raise ConfigError(f"the duration of {duration_s:g} s must lie between 0 and {every_s:g} s")
    increments = _increments(log)
    is_wrong = (log.stamps[1:] - log.stamps[0]) % every_s > every_s - duration_s
    increments[is_wrong, :2] *= -1.0
    return _changed(log, increments)


def dead(log: SimulatedLog, *, from_share: float = 0.5) -> SimulatedLog:
    """Odometry that dies: from this share of the log on it repeats its last pose; 0 for one that never moves."""
    T = _odometry(log).copy()
    first = int(_share(from_share) * (len(T) - 1))
    T[first:] = T[first]
    return log.with_odometry(T)


def _odometry(log: SimulatedLog) -> FloatArray:
    """(n, 3) odometry of the log, which must have it."""
    if not np.isfinite(log.T_odom_base).all():
        raise InputError(f"{log.path}: faults of the odometry need a log with odometry at each scan")
    return log.T_odom_base


def _increments(log: SimulatedLog) -> FloatArray:
    """(n - 1, 3) motion that the odometry tells from scan to scan."""
    T = _odometry(log)
    return se2.between(T[:-1], T[1:])


def _changed(log: SimulatedLog, increments: FloatArray) -> SimulatedLog:
    """The log with these increments (n - 1, 3) as its odometry, beginning where it did."""
    if not np.isfinite(increments).all():
        raise ConfigError("the fault of the odometry must be finite")
    return log.with_odometry(se2.compose(log.T_odom_base[0], accumulate(increments)))


def _during(log: SimulatedLog, from_share: float, duration_s: float) -> BoolArray:
    """(n - 1,) mask of the increments within a time."""
    if not 0.0 <= duration_s < np.inf:
        raise ConfigError(f"the duration must be zero or positive, not {duration_s:g} s")
    since_s = log.stamps[1:] - log.stamps[0]
    first_s = _share(from_share) * (log.stamps[-1] - log.stamps[0])
    is_within: BoolArray = (since_s > first_s) & (since_s <= first_s + duration_s + 1e-9)
    return is_within


def _share(share: float) -> float:
    if not 0.0 <= share < 1.0:
        raise ConfigError(f"the share of the log must be in [0, 1), not {share:g}")
    return share


def _count(n: int) -> int:
    if n < 1:
        raise ConfigError(f"the number of scans must be at least 1, not {n}")
    return n
