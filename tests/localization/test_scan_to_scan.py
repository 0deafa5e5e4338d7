from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import FloatArray
from slammot_graph.localization import ScanToScan
from slammot_graph.localization.config import ScanToScanConfig, StepConfig
from slammot_graph.odometry import OdometryNoise, WheelOdometry
from slammot_graph.odometry.fallback import OdometryOrPreviousMotion
from slammot_graph.registration.point_to_point import PointToPointConfig
from tests.rooms import take_scan

A = np.array([2.0, 0.0, 1.5])
STEP = np.array([0.01, 0.005, 0.004])


def test_scans_are_chained_by_their_matches() -> None:
    localizer = ScanToScan(
        WheelOdometry(OdometryNoise()), ScanToScanConfig(point_to_point=PointToPointConfig(tau_m=1e-9))
    )
    poses = [A, se2.compose(A, STEP), se2.compose(se2.compose(A, STEP), STEP)]
    total, cov = np.zeros(3), localizer.estimate.cov_absolute
    for k, T in enumerate(poses):
        scan = take_scan(T, index=k, T_odom_base=np.array([0.02 * k, 0.0, 0.0]))
        localizer.predict(scan)
        estimate, match = localizer.match(scan.points_base(), scan.is_valid())
        localizer.commit(scan, scan.points_base(), scan.is_valid())
        assert (match is None) == (k == 0)
        if match is not None:
            total = se2.compose(total, match.T_ref_base)
            cov = se2.compound_covariance(cov, match.T_ref_base, match.cov)
            np.testing.assert_allclose(estimate.cov_relative, match.cov)
        np.testing.assert_allclose(estimate.T_local_base, total, atol=1e-12)
        np.testing.assert_allclose(estimate.cov_absolute, cov, rtol=1e-9)
    np.testing.assert_allclose(localizer.final().T_map_base[-1], total, atol=1e-12)


def occluded(scan: Scan) -> Scan:
    scan.ranges[:] = np.nan
    return scan


def test_an_occluded_scan_falls_back_on_the_odometry_and_so_does_the_next() -> None:
    localizer, statuses = ScanToScan(WheelOdometry(OdometryNoise()), ScanToScanConfig()), []
    for k in range(4):
        T = se2.compose(A, k * STEP)
        scan = take_scan(T, index=k)
        if k == 1:
            occluded(scan)
        localizer.predict(scan)
        estimate, match = localizer.match(scan.points_base(), scan.is_valid())
        localizer.commit(scan, scan.points_base(), scan.is_valid())
        statuses.append(match.status if match else None)
        if k in (1, 2):
            assert estimate.T_local_base == pytest.approx(se2.between(A, T), abs=1e-12)
    assert statuses == [None, "failed", "failed", "converged"]


def driven(step: StepConfig | None, odometry: Sequence[FloatArray | None], dt: float = 0.1) -> list[bool]:
    """Which scans of a drive are matched, the first one aside; each one's map flag has to follow `maps_between`."""
    localizer = ScanToScan(OdometryOrPreviousMotion(OdometryNoise()), ScanToScanConfig(step=step))
    matched = []
    for k, T in enumerate(odometry):
        scan = take_scan(A if T is None else se2.compose(A, T), index=k)
        scan = replace(scan, stamp=100.0 + dt * k, T_odom_base=T)
        localizer.predict(scan)
        _, match = localizer.match(scan.points_base(), scan.is_valid())
        committed = localizer.commit(scan, scan.points_base(), scan.is_valid())
        is_cycle = match is not None or k == 0
        assert committed.expects_match == is_cycle
        assert committed.is_mapped == (is_cycle or (step is not None and step.maps_between))
        matched.append(match is not None)
    return matched[1:]


def forth(distance_m: float, n: int = 8) -> list[FloatArray]:
    return [np.array([distance_m * k, 0.0, 0.0]) for k in range(n)]


@pytest.mark.parametrize("maps_between", [True, False])
def test_a_cycle_is_due_after_the_distance_turn_or_time_of_a_step(maps_between: bool) -> None:
    never = StepConfig(distance_m=np.inf, turn_rad=np.inf, time_s=np.inf, maps_between=maps_between)
    third = [False, False, True, False, False, True, False]
    assert driven(replace(never, distance_m=0.25), forth(0.1)) == third
    back = [np.array([0.1 * (k % 2), 0.0, 0.0]) for k in range(8)]  # the path counts, not where it leads
    assert driven(replace(never, distance_m=0.25), back) == third
    turns = [np.array([0.0, 0.0, -0.1 * k]) for k in range(8)]
    assert driven(replace(never, turn_rad=0.25), turns) == third
    assert driven(replace(never, time_s=0.3), forth(0.0)) == third
    assert driven(replace(never, time_s=0.3), forth(0.0), dt=-0.1) == third
    assert not any(driven(never, forth(0.1)))


def test_without_a_step_or_without_odometry_every_scan_is_a_cycle() -> None:
    assert all(driven(None, forth(0.01)))
    step = StepConfig(distance_m=0.25, turn_rad=0.25)
    assert all(driven(step, [None] * 6))
    mixed = [*forth(0.05, 3), None, np.array([0.2, 0.0, 0.0]), np.array([0.25, 0.0, 0.0])]
    # without odometry at one of two scans nothing tells the motion between them
    assert driven(step, mixed) == [False, False, True, False, False]


def test_between_the_cycles_the_odometry_carries_pose_and_covariance() -> None:
    noise = OdometryNoise()
    step = StepConfig(distance_m=0.25, turn_rad=np.inf)
    localizer = ScanToScan(WheelOdometry(noise), ScanToScanConfig(step=step))
    increment = np.array([0.1, 0.02, 0.05])
    told = np.array([0.105, 0.018, 0.04])  # by odometry that is not quite right
    T_true, T_odom = A, np.zeros(3)
    T_cycle, cov_cycle = np.zeros(3), localizer.estimate.cov_absolute
    T, cov_since, cov_absolute = T_cycle, np.zeros((3, 3)), cov_cycle
    n_matches = 0
    for k in range(8):
        scan = take_scan(T_true, index=k, T_odom_base=T_odom)
        predicted = localizer.predict(scan)
        if k:
            T = se2.compose(T, told)
            cov_since = se2.compound_covariance(cov_since, told, noise.covariance(told))
            cov_absolute = se2.compound_covariance(cov_absolute, told, noise.covariance(told))
            np.testing.assert_allclose(predicted.T_local_base, T, atol=1e-12)
            np.testing.assert_allclose(predicted.cov_relative, cov_since, rtol=1e-9)
            np.testing.assert_allclose(predicted.cov_absolute, cov_absolute, rtol=1e-9)
        estimate, match = localizer.match(scan.points_base(), scan.is_valid())
        localizer.commit(scan, scan.points_base(), scan.is_valid())
        if match is None:
            assert estimate is predicted
        else:
            n_matches += 1
            T_cycle = se2.compose(T_cycle, match.T_ref_base)
            cov_cycle = se2.compound_covariance(cov_cycle, match.T_ref_base, match.cov)
            T, cov_since, cov_absolute = T_cycle, np.zeros((3, 3)), cov_cycle
            np.testing.assert_allclose(estimate.T_local_base, T_cycle, atol=1e-12)
            np.testing.assert_allclose(estimate.cov_absolute, cov_cycle, rtol=1e-9)
        T_true, T_odom = se2.compose(T_true, increment), se2.compose(T_odom, told)
    assert n_matches == 2


@pytest.mark.parametrize("name", ["distance_m", "turn_rad", "time_s"])
def test_a_step_of_nothing_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=f"StepConfig.{name} must be positive, not 0.0"):
        StepConfig(**{name: 0.0})  # type: ignore[arg-type]
