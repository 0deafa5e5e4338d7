"""Logs of a robot alone that drives a route among walls."""

import numpy as np

from slammot_graph.core.types import FloatArray
from slammot_graph.simulation import SimulatedLog
from slammot_graph.simulation.laser import LMS200, measure
from slammot_graph.simulation.robot import DriveConfig, OdometryNoise, drive, simulate_odometry


def driven(name: str, walls: FloatArray, route: FloatArray, seed: int, *, noise_scale: float) -> SimulatedLog:
    """5 scans a second at up to 1 m/s along waypoints (m, 2) among walls (k, 4) [m]."""
    streams = np.random.default_rng(seed).spawn(3)
    laser, nobody = LMS200.at_rate(5.0), np.empty((0, 3))
    T_world_base = drive(route, DriveConfig(max_speed_m_s=1.0, max_accel_m_s2=1.0), 0.2, streams[0])
    n = len(T_world_base)
    T_odom_base, _ = simulate_odometry(T_world_base, OdometryNoise(), streams[1], noise_scale=noise_scale)
    ranges, hits = measure(T_world_base, laser, walls, np.broadcast_to(nobody, (n, 0, 3)), streams[2])
    return SimulatedLog(
        name=name,
        laser=laser.model,
        stamps=0.2 * np.arange(float(n)),
        ranges=ranges,
        T_odom_base=T_odom_base,
        T_world_base=T_world_base,
        is_moving=np.zeros(hits.shape, dtype=bool),
        object_id=np.full(hits.shape, -1),
        objects=np.empty((n, 0, 4)),
    )
