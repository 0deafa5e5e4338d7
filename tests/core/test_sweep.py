"""Where the beams of a sweep start and end."""

from dataclasses import replace

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.scan import LaserModel, Scan
from slammot_graph.core.sweep import SweepMotion
from slammot_graph.core.types import FloatArray

LASER = LaserModel(
    angle_min=2.0,
    angle_increment=-0.1,
    n_beams=40,
    range_min=0.1,
    range_max=20.0,
    T_base_laser=(0.2, -0.1, 0.4),
)
TIMES = 0.003 * np.arange(40.0)


def swept(rng: np.random.Generator) -> Scan:
    knots = np.cumsum(rng.normal(0.0, [0.02, 0.02, 0.1], (5, 3)), axis=0)
    sweep = SweepMotion(first_s=0.0, last_s=TIMES[-1], T_stamp_base=knots, cov_velocity=np.eye(3))
    ranges = rng.uniform(0.5, 10.0, 40)
    ranges[4] = np.inf
    return Scan(
        index=0, stamp=1.0, ranges=ranges, laser=LASER, T_odom_base=None, beam_times=TIMES, sweep=sweep
    )


def test_each_beam_starts_where_the_laser_was_at_its_time(rng: np.random.Generator) -> None:
    scan = swept(rng)
    assert scan.sweep is not None
    T_stamp_base: FloatArray = scan.sweep.at(TIMES)
    for k, T in enumerate(T_stamp_base):
        origin = se2.transform(T, LASER.origin_base[None])[0]
        direction = se2.rotation(T[2]) @ LASER.directions_base[k]
        np.testing.assert_allclose(scan.origins_base[k], origin, atol=1e-12)
        np.testing.assert_allclose(scan.directions_base[k], direction, atol=1e-12)
        if k == 4:
            assert np.isnan(scan.points_base()[k]).all()
            continue
        np.testing.assert_allclose(scan.points_base()[k], origin + scan.ranges[k] * direction, atol=1e-12)


def test_a_robot_that_stands_bends_nothing(rng: np.random.Generator) -> None:
    scan = swept(rng)
    still = SweepMotion(first_s=0.0, last_s=0.1, T_stamp_base=np.zeros((2, 3)), cov_velocity=np.zeros((3, 3)))
    at_once = replace(scan, sweep=None)
    np.testing.assert_allclose(replace(scan, sweep=still).points_base(), at_once.points_base(), atol=1e-12)
    assert at_once.origins_base.shape == (1, 2)


def test_a_scan_that_was_deskewed_needs_beam_times(rng: np.random.Generator) -> None:
    with pytest.raises(ValueError, match="beam times"):
        replace(swept(rng), beam_times=None).points_base()


def test_a_velocity_is_added_from_the_stamp_on(rng: np.random.Generator) -> None:
    sweep = swept(rng).sweep
    assert sweep is not None
    velocity, cov = np.array([0.3, -0.1, 2.0]), 0.5 * np.eye(3)
    faster = sweep.corrected(velocity, cov)
    np.testing.assert_array_equal(faster.cov_velocity, cov)
    for time_s, before, after in zip(sweep.knot_times, sweep.T_stamp_base, faster.T_stamp_base, strict=True):
        expected = se2.compose(se2.exp(time_s * velocity), before)
        np.testing.assert_allclose(se2.between(expected, after), np.zeros(3), atol=1e-12)
    steady = SweepMotion(first_s=0.0, last_s=0.2, T_stamp_base=np.zeros((3, 3)), cov_velocity=cov).corrected(
        velocity, cov
    )
    np.testing.assert_allclose(steady.velocity, velocity, atol=1e-9)
