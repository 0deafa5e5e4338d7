"""The detectors and their factory; how the ellipse detector decides what a match deserves."""

from dataclasses import replace

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import FloatArray
from slammot_graph.detection import reasons
from slammot_graph.detection.base import Detection
from slammot_graph.detection.ellipse_detector import (
    EllipseDetector,
    EllipseDetectorConfig,
    LocalGridConfig,
    RetestConfig,
)
from slammot_graph.detection.factory import make_detector
from slammot_graph.detection.no_detection import NoDetection, NoDetectionConfig
from slammot_graph.localization import Estimate
from slammot_graph.mapping.occupancy_grid import GridConfig, OccupancyGrid
from slammot_graph.odometry.noise import ConstantNoise
from slammot_graph.tracking.no_tracking import NoTracking
from tests.rooms import LASER, ROOM, box, take_scan

NOWHERE = np.empty((0, 2))
CORRIDOR = box(-7.0, -2.0, 9.0, 2.0)
PERSON = [[1.0, 2.5, 0.25]]
A = np.array([0.5, 0.3, 0.2])


def at(T: FloatArray) -> Estimate:
    return Estimate(T_local_base=T, cov_relative=1e-6 * np.eye(3), cov_absolute=4e-6 * np.eye(3))


def matched(**changes: object) -> MatchResult:
    result = MatchResult(
        status="converged",
        T_ref_base=np.zeros(3),
        innovation=np.zeros(3),
        cov=np.eye(3),
        information=np.eye(3),
        graph_information=np.eye(3),
        hessian_information=np.eye(3),
        cov_correlated=np.zeros((3, 3)),
        n_iterations=1,
        n_correspondences=100,
        inlier_ratio=1.0,
        residual_m=0.01,
        nis=1.0,
    )
    return replace(result, **changes)  # type: ignore[arg-type]


def seeing(config: EllipseDetectorConfig) -> tuple[EllipseDetector, Scan]:
    """A detector that has seen the empty room some times, and a scan with a person in it."""
    detector = EllipseDetector(config, max_range_m=40.0)
    for k in range(15):
        scan = take_scan(A, index=k, walls=ROOM)
        is_valid = scan.is_valid()
        detector.update(scan, scan.points(A), is_valid, is_valid, A, is_keyframe=k % 5 == 0, is_lost=False)
    return detector, take_scan(A, index=15, walls=ROOM, discs=PERSON)


def detect(detector: EllipseDetector, scan: Scan, T: FloatArray = A) -> Detection:
    return detector.detect(scan, scan.is_valid(), at(T), NOWHERE)


def retest(
    detector: EllipseDetector, scan: Scan, detection: Detection, match: MatchResult, T: FloatArray = A
) -> Detection:
    return detector.retest(scan, scan.is_valid(), detection, at(T), match, NOWHERE)


def test_the_factory_builds_what_the_configuration_names() -> None:
    assert isinstance(make_detector(NoDetectionConfig(), max_range_m=9.0), NoDetection)
    own = make_detector(EllipseDetectorConfig(), max_range_m=9.0)
    assert isinstance(own, EllipseDetector)
    assert own.grid.is_rolling
    grid = OccupancyGrid(GridConfig())
    paper = make_detector(EllipseDetectorConfig(local_grid=None), max_range_m=9.0, map_grid=grid)
    assert paper.grid is grid
    with pytest.raises(ValueError, match="needs the map's"):
        make_detector(EllipseDetectorConfig(local_grid=None), max_range_m=9.0)


def test_no_detection_detects_nothing() -> None:
    detector, scan = NoDetection(), take_scan(A, discs=PERSON)
    is_valid = scan.is_valid()
    found = detector.detect(scan, is_valid, at(A), NOWHERE)
    assert not found.is_moving.any()
    assert detector.retest(scan, is_valid, found, at(A), matched(status="failed"), NOWHERE) is found
    assert detector.kernel_factor(found, is_valid) == 1.0
    p = detector.p_moving(scan, found, scan.points(A), NOWHERE)
    np.testing.assert_array_equal(p, np.where(is_valid, 0.0, np.nan))
    assert detector.retrospective_labels([], np.empty((0, 3)), NoTracking()) is None
    assert detector.grid is None


def test_the_pose_covariance_is_the_one_asked_for() -> None:
    for asked, expected in (
        ("relative", 1e-6 * np.eye(3)),
        ("absolute", 4e-6 * np.eye(3)),
        (ConstantNoise(), np.diag([0.01, 0.01, 0.0025])),
    ):
        config = EllipseDetectorConfig(test_covariance=asked)  # type: ignore[arg-type]
        np.testing.assert_allclose(EllipseDetector(config, max_range_m=9.0).pose_covariance(at(A)), expected)


@pytest.mark.parametrize(
    ("mapped_share", "has_odometry", "reason"),
    [
        (0.2, True, reasons.UNSUPPORTED),
        (0.2, False, reasons.ABSTAINED),
        (1.0, True, reasons.ABSTAINED),
    ],
)
def test_a_match_that_failed_or_is_improbable_takes_everything_back(
    mapped_share: float, has_odometry: bool, reason: int
) -> None:
    detector, scan = seeing(EllipseDetectorConfig(retest=RetestConfig(mapped_share=mapped_share)))
    scan = replace(scan, T_odom_base=A if has_odometry else None)
    found = detect(detector, scan)
    assert found.is_moving.sum() > 5
    for match in (matched(status="failed"), matched(nis=51.0)):
        told = retest(detector, scan, found, match)
        assert not told.is_moving.any()
        np.testing.assert_array_equal(told.reason == reason, found.is_moving)
        np.testing.assert_array_equal(
            told.is_mapped(scan.is_valid()),
            scan.is_valid() & (~found.is_moving | (reason == reasons.ABSTAINED)),
        )


def test_the_test_is_made_again_only_where_points_change_their_cells() -> None:
    config = EllipseDetectorConfig(retest=RetestConfig(same_cells=0.2))
    detector, scan = seeing(config)
    found = detect(detector, scan)
    near, far = A + np.array([0.005, 0.0, 0.0]), A + np.array([0.05, 0.0, 0.0])  # 0.2 of a cell are 2 cm
    assert retest(detector, scan, found, matched(), near) is found
    again = retest(detector, scan, found, matched(), far)
    assert again is not found
    # it was made there: a match that stays there needs no third one
    assert retest(detector, scan, again, matched(), far) is again
    without = EllipseDetector(EllipseDetectorConfig(retest=None), max_range_m=40.0)
    assert retest(without, scan, found, matched(status="failed"), far) is found


def test_the_kernel_gets_narrower_in_a_crowd() -> None:
    detector = EllipseDetector(EllipseDetectorConfig(), max_range_m=9.0)
    is_valid = np.ones(100, dtype=np.bool_)
    for n_moving, factor in ((0, 1.0), (15, 1.0), (16, 0.84**2), (30, 0.7**2), (60, 0.4)):
        is_moving = np.arange(100) < n_moving
        found = Detection.nothing(is_valid)._replace(is_moving=is_moving)
        assert detector.kernel_factor(found, is_valid) == pytest.approx(factor)
        careless = EllipseDetector(EllipseDetectorConfig(retest=None), max_range_m=9.0)
        assert careless.kernel_factor(found, is_valid) == 1.0
    assert detector.kernel_factor(Detection.nothing(np.zeros(3, dtype=np.bool_)), is_valid[:0]) == 1.0


def test_memory_begins_with_the_latest_keyframes_and_anew_where_the_robot_is_lost() -> None:
    config = EllipseDetectorConfig(local_grid=LocalGridConfig(n_keyframes=2))
    detector = EllipseDetector(config, max_range_m=10.0)
    starts = []
    for k in range(8):
        scan = take_scan(A, index=k)
        is_valid = scan.is_valid()
        detector.update(scan, scan.points(A), is_valid, is_valid, A, is_keyframe=k % 2 == 0, is_lost=k == 6)
        starts.append(detector.window_start)
    assert starts == [0, 0, 0, 0, 2, 2, 6, 6]


def test_a_grid_that_is_the_maps_is_left_to_it() -> None:
    grid = OccupancyGrid(GridConfig())
    detector = EllipseDetector(EllipseDetectorConfig(local_grid=None), max_range_m=9.0, map_grid=grid)
    scan = take_scan(A)
    is_valid = scan.is_valid()
    detector.update(scan, scan.points(A), is_valid, is_valid, A, is_keyframe=True, is_lost=False)
    assert (grid.stamp == -1).all()


def test_what_was_vacated_is_forgotten_where_the_robot_is_lost() -> None:
    """Who steps aside is seen through where he stood, unless the robot may be elsewhere by now."""
    for is_lost in (False, True):
        detector = EllipseDetector(EllipseDetectorConfig(), max_range_m=10.0)
        first = take_scan(se2.IDENTITY, walls=CORRIDOR, index=0, discs=[[2.0, 0.0, 0.25]])
        second = take_scan(se2.IDENTITY, walls=CORRIDOR, index=15, discs=[[2.4, 0.0, 0.25]])
        assert second.stamp - first.stamp >= 1.0
        is_valid = first.is_valid()
        detector.update(
            first, first.points_base(), is_valid, is_valid, se2.IDENTITY, is_keyframe=True, is_lost=False
        )
        if is_lost:
            nothing = np.zeros(LASER.n_beams, dtype=np.bool_)
            scan = take_scan(se2.IDENTITY, walls=CORRIDOR, index=14)
            detector.update(
                scan, scan.points_base(), nothing, nothing, se2.IDENTITY, is_keyframe=False, is_lost=True
            )
        found = detect(detector, second, se2.IDENTITY)
        assert (found.reason == reasons.VACATED).any() != is_lost
