import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.scan import Scan
from slammot_graph.localization import ScanToScan
from slammot_graph.odometry import OdometryNoise, WheelOdometry
from slammot_graph.registration.point_to_point import PointToPointConfig
from tests.rooms import take_scan

A = np.array([2.0, 0.0, 1.5])
STEP = np.array([0.01, 0.005, 0.004])


def test_scans_are_chained_by_their_matches() -> None:
    localizer = ScanToScan(WheelOdometry(OdometryNoise()), PointToPointConfig(tau_m=1e-9))
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
    localizer, statuses = ScanToScan(WheelOdometry(OdometryNoise()), PointToPointConfig()), []
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
