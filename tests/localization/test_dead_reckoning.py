import numpy as np

from slammot_graph.core import se2
from slammot_graph.localization import DeadReckoning
from slammot_graph.localization.base import FIRST_COV
from slammot_graph.odometry.noise import OdometryNoise
from tests.rooms import drive


def test_trajectory_is_the_odometry_from_its_start() -> None:
    log, noise = drive(10), OdometryNoise()
    localizer = DeadReckoning(noise)
    odometry = np.array([scan.T_odom_base for scan in log])
    expected = se2.between(odometry[0], odometry)
    cov = FIRST_COV
    for k, scan in enumerate(log):
        predicted = localizer.predict(scan)
        matched, match = localizer.match(scan.points_base(), scan.is_valid())
        committed = localizer.commit(scan, scan.points_base(), scan.is_valid())
        assert (committed.node, committed.is_keyframe, committed.events) == (None, False, ())
        assert match is None
        assert matched is predicted
        np.testing.assert_allclose(predicted.T_local_base, expected[k], atol=1e-12)
        if k:
            step = se2.between(odometry[k - 1], odometry[k])
            cov = se2.compound_covariance(cov, step, noise.covariance(step))
            np.testing.assert_allclose(predicted.cov_relative, noise.covariance(step))
        np.testing.assert_allclose(predicted.cov_absolute, cov, atol=1e-15)
    final = localizer.final()
    np.testing.assert_allclose(final.T_map_base, expected, atol=1e-12)
    np.testing.assert_allclose(final.cov_map[-1], cov, atol=1e-15)
    assert (len(final.nodes), len(final.node_scans), final.edges) == (0, 0, ())
    np.testing.assert_array_equal(localizer.T_map_local, np.zeros(3))
    localizer.close()


def test_nothing_yet_is_an_empty_trajectory() -> None:
    final = DeadReckoning(OdometryNoise()).final()
    assert final.T_map_base.shape == (0, 3)
    assert final.cov_map.shape == (0, 3, 3)
