"""The velocity during a sweep, found by matching and joined from sweep to sweep."""

from dataclasses import replace

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.scan import Scan
from slammot_graph.core.sweep import SweepMotion
from slammot_graph.core.types import FloatArray
from slammot_graph.localization.config import ScanToMapConfig
from slammot_graph.localization.scan_to_map import ScanToMap
from slammot_graph.localization.sweep_estimate import MAX_ROUNDS, SweepEnd, SweepEstimate
from slammot_graph.odometry.adaptive import AdaptiveOdometry, AdaptiveOdometryConfig
from slammot_graph.odometry.noise import OdometryNoise
from tests.registration.keyframes import A, circle, local_map_of
from tests.rooms import LASER, take_scan

T = se2.compose(A, np.array([0.1, -0.05, 0.3]))
VELOCITY = np.array([0.5, 0.1, 1.2])
TIMES = 0.1 * np.arange(LASER.n_beams) / LASER.n_beams
WIDE = np.diag(np.square([0.5, 0.5, 1.0]))


def swept_scan(velocity: FloatArray, rng: np.random.Generator, stamp: float = 0.0) -> Scan:
    """A sweep from `T` on in which the robot moves at `velocity`."""
    poses = se2.compose(T, se2.exp(TIMES[:, None] * velocity))
    ranges = np.array([take_scan(pose).ranges[k] for k, pose in enumerate(poses)])
    ranges += rng.normal(0.0, 0.01, len(ranges))
    return Scan(index=0, stamp=stamp, ranges=ranges, laser=LASER, T_odom_base=None, beam_times=TIMES)


def still(cov: FloatArray = WIDE) -> SweepMotion:
    return SweepMotion(first_s=0.0, last_s=float(TIMES[-1]), T_stamp_base=np.zeros((9, 3)), cov_velocity=cov)


def test_the_match_finds_the_velocity(rng: np.random.Generator) -> None:
    local_map = local_map_of(circle(6), rng)
    scan = swept_scan(VELOCITY, rng)
    estimate = SweepEstimate(still(), ScanToMapConfig().point_to_line)
    scan = replace(scan, sweep=estimate.prior)
    n_rounds = 0
    while (sweep := estimate.improved(scan, scan.is_valid(), local_map, T, 1e-6 * np.eye(3))) is not None:
        scan, n_rounds = replace(scan, sweep=sweep), n_rounds + 1
    assert 1 < n_rounds <= MAX_ROUNDS
    assert scan.sweep is not None
    std = np.sqrt(np.diag(scan.sweep.cov_velocity))
    assert (np.abs(scan.sweep.velocity - VELOCITY) < np.minimum(3.0 * std, [0.1, 0.1, 0.1])).all()


def test_a_velocity_that_is_known_stays(rng: np.random.Generator) -> None:
    local_map = local_map_of(circle(6), rng)
    estimate = SweepEstimate(still(1e-10 * np.eye(3)), ScanToMapConfig().point_to_line)
    scan = replace(swept_scan(VELOCITY, rng), sweep=estimate.prior)
    sweep = estimate.improved(scan, scan.is_valid(), local_map, T, 0.01 * np.eye(3))
    assert sweep is not None
    np.testing.assert_allclose(sweep.velocity, 0.0, atol=1e-4)
    np.testing.assert_allclose(estimate.cov_pose, 0.0, atol=1e-9)


def test_a_sweep_goes_on_until_the_next_one_begins() -> None:
    cov = np.diag([1e-4, 1e-4, 1e-4, 0.01, 0.01, 0.04])
    sweep = still().corrected(VELOCITY, WIDE)
    end = SweepEnd(stamp=5.0, T_local_base=T, sweep=sweep, cov=cov)
    after_s = float(TIMES[-1])
    found = end.at(5.0 + after_s)
    assert found is not None
    np.testing.assert_allclose(found[0], se2.compose(T, se2.exp(after_s * VELOCITY)), atol=1e-9)
    # by Monte Carlo
    rng = np.random.default_rng(0)
    draws = rng.multivariate_normal(np.zeros(6), cov, 20_000)
    moved = se2.compose(
        se2.compose(T, se2.exp(draws[:, :3] + after_s * draws[:, 3:])), sweep.at(TIMES[-1:])[0]
    )
    errors = se2.log(se2.between(found[0], moved))
    np.testing.assert_allclose(found[1], np.cov(errors.T), atol=3e-5)
    later = end.at(5.0 + 1.4 * after_s)
    assert later is not None and (np.diag(later[1]) > np.diag(found[1])).all()
    assert end.at(5.0 + 3.0 * after_s) is None and end.at(5.0) is None


@pytest.mark.parametrize("with_odometry", [True, False])
def test_sweeps_of_a_turning_robot_are_matched(rng: np.random.Generator, *, with_odometry: bool) -> None:
    """A room that is bent by 0.12 rad from the first beam to the last, if it is not deskewed."""
    localizer = ScanToMap(AdaptiveOdometry(OdometryNoise(), AdaptiveOdometryConfig()), ScanToMapConfig())
    start, errors = np.array([0.5, 0.3, 0.2]), []
    for k in range(25):
        # from rest, so that the first scan is not bent
        path = se2.compose(start, se2.exp(_driven(0.1 * k + TIMES)[:, None] * VELOCITY))
        ranges = np.array([take_scan(pose).ranges[b] for b, pose in enumerate(path)])
        odometry = se2.exp(_driven(np.array([0.1 * k]))[:, None] * VELOCITY)[0]
        scan = Scan(
            index=k,
            stamp=0.1 * k,
            ranges=ranges + rng.normal(0.0, 0.01, len(ranges)),
            laser=LASER,
            T_odom_base=odometry if with_odometry else None,
            beam_times=TIMES,
        )
        localizer.predict(scan)
        scan = localizer.deskew(scan)
        is_valid = scan.is_valid()
        localizer.match(scan.points_base(), is_valid)
        while (deskewed := localizer.deskew_again(scan, is_valid)) is not None:
            scan = deskewed
            localizer.match(scan.points_base(), is_valid)
        scan, matched, match = localizer.join_sweep(scan)
        assert match is None or match.status == "converged"
        localizer.commit(scan, scan.points_base(), is_valid)
        errors.append(se2.log(se2.between(matched.T_local_base, se2.between(start, path[0]))))
    assert np.abs(errors).max() < (0.02 if with_odometry else 0.03)


def _driven(times_s: FloatArray) -> FloatArray:
    """(n,) seconds at full speed that a drive has made, which takes a second to get there."""
    return np.where(times_s < 1.0, 0.5 * times_s**2, times_s - 0.5)
