import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.localization.config import ScanToLocalMapConfig, StepConfig
from slammot_graph.localization.scan_to_local_map import ScanToLocalMap
from slammot_graph.odometry import OdometryNoise, WheelOdometry
from slammot_graph.registration.point_to_line import PointToLineConfig
from slammot_graph.registration.point_to_point import PointToPointConfig
from tests.rooms import take_scan

A = np.array([2.0, 0.0, 1.5])
TRUE, TOLD = np.array([0.06, 0.01, 0.03]), np.array([0.063, 0.008, 0.027])


def driven(config: ScanToLocalMapConfig, n: int = 24) -> tuple[ScanToLocalMap, FloatArray, list[bool]]:
    """A drive with odometry that is not quite right: the localizer, the last true pose, which scans were matched."""
    localizer, matched = ScanToLocalMap(WheelOdometry(OdometryNoise()), config), []
    T_true, T_odom = A, np.zeros(3)
    for k in range(n):
        scan = take_scan(T_true, index=k, T_odom_base=T_odom)
        predicted = localizer.predict(scan)
        estimate, match = localizer.match(scan.points_base(), scan.is_valid())
        if match is not None:
            assert match.status == "converged"
            assert np.trace(estimate.cov_relative) < np.trace(predicted.cov_relative)
        committed = localizer.commit(scan, scan.points_base(), scan.is_valid())
        assert committed.expects_match == (match is not None or k == 0)
        matched.append(match is not None)
        T_end = T_true
        T_true, T_odom = se2.compose(T_true, TRUE), se2.compose(T_odom, TOLD)
    return localizer, se2.between(A, T_end), matched


@pytest.mark.parametrize(
    ("config", "largest_m"),
    [(PointToLineConfig(), 0.005), (PointToPointConfig(kept_share=0.8, tau_m=1e-6), 0.05)],
)
def test_matches_onto_the_local_map_take_the_odometrys_error_away(
    config: PointToLineConfig | PointToPointConfig, largest_m: float
) -> None:
    localizer, T_end, matched = driven(ScanToLocalMapConfig(matcher=config))
    assert matched == [False, *[True] * 23]
    assert len(localizer.local_map.keyframes) > 3
    told = np.zeros(3)
    for _ in range(23):
        told = se2.compose(told, TOLD)
    error = np.hypot(*(localizer.estimate.T_local_base - T_end)[:2])
    assert error < largest_m
    assert error < 0.5 * np.hypot(*(told - T_end)[:2])


def test_between_the_cycles_of_a_step_nothing_is_matched() -> None:
    step = StepConfig(distance_m=0.25, turn_rad=np.inf)  # every fourth scan, 6.4 cm apart
    localizer, _, matched = driven(ScanToLocalMapConfig(step=step), n=13)
    assert matched == [k % 4 == 0 and k > 0 for k in range(13)]
    assert len(localizer.final().T_map_base) == 13
    assert (np.linalg.eigvalsh(localizer.estimate.cov_absolute) > 0.0).all()
