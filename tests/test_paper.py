"""The paper's equations 1 to 9 and its steps 1 to 7, each held to a case computed by hand."""

import math

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.scan import LaserModel, Scan
from slammot_graph.core.types import BoolArray
from slammot_graph.detection.clustering import ClusterConfig, find_clusters
from slammot_graph.detection.ellipse_detector import EllipseDetectorConfig
from slammot_graph.detection.ellipse_test import EllipseTestConfig, detect_moving, end_point_covariances
from slammot_graph.mapping.occupancy_grid import GridConfig, OccupancyGrid
from slammot_graph.methods import get_method
from slammot_graph.odometry.noise import ConstantNoise
from slammot_graph.pipeline import Pipeline
from slammot_graph.pipeline_config import PipelineConfig
from slammot_graph.registration.point_to_point import PointToPointConfig, match_scans
from tests.rooms import is_person, take_scan

CROSS = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
ALL = np.full(4, True)
LASER = LaserModel(
    angle_min=-math.radians(30.0),
    angle_increment=math.radians(30.0),
    n_beams=3,
    range_min=0.05,
    range_max=30.0,
    T_base_laser=(0.0, 0.0, 0.0),
)


def config_of(name: str) -> PipelineConfig:
    config = get_method(name).config
    assert isinstance(config, PipelineConfig)
    return config


def paper_detector(name: str = "docpfo") -> EllipseDetectorConfig:
    detector = config_of(name).detector
    assert isinstance(detector, EllipseDetectorConfig)
    return detector


def beams(*ranges: float) -> Scan:
    return Scan(index=0, stamp=0.0, ranges=np.array(ranges), laser=LASER, T_odom_base=np.zeros(3))


def test_equation_1_the_pose_after_a_motion() -> None:
    # at (1, 2), facing y, the robot goes 2 m ahead and 1 m to its left, which is -x, and turns by 30 degrees
    pose = se2.compose(np.array([1.0, 2.0, math.pi / 2]), np.array([2.0, 1.0, math.pi / 6]))
    np.testing.assert_allclose(pose, [0.0, 4.0, 2 * math.pi / 3], atol=1e-12)


def test_equations_2_and_8_a_point_in_the_global_frame() -> None:
    point = se2.transform(np.array([1.0, 2.0, math.pi / 2]), np.array([[3.0, 1.0]]))
    np.testing.assert_allclose(point, [[0.0, 5.0]], atol=1e-12)


def test_equation_3_pairs_are_nearest_points_and_equation_4_moves_them_onto_each_other() -> None:
    points = CROSS - [0.1, 0.2]
    result = match_scans(CROSS, ALL, points, ALL, np.zeros(3), PointToPointConfig(max_iterations=1))
    np.testing.assert_allclose(result.T_ref_base, [0.1, 0.2, 0.0], atol=1e-12)
    assert result.residual_m == pytest.approx(math.hypot(0.1, 0.2))  # d_1, before the step
    turned = np.array([[0.96, 0.28], [-0.28, 0.96], [-0.96, -0.28], [0.28, -0.96]])  # by atan(7 / 24)
    result = match_scans(turned, ALL, CROSS, ALL, np.zeros(3), PointToPointConfig(max_iterations=1))
    np.testing.assert_allclose(result.T_ref_base, [0.0, 0.0, math.atan2(7.0, 24.0)], atol=1e-12)


@pytest.mark.parametrize(("tau_m", "n_iterations"), [(0.3, 2), (0.2, 3)])
def test_equation_5_stops_when_the_distance_falls_by_less_than_tau(tau_m: float, n_iterations: int) -> None:
    # d_1 = 0.2236, d_2 = d_3 = 0: it falls by 0.2236, then by nothing
    points = CROSS - [0.1, 0.2]
    result = match_scans(CROSS, ALL, points, ALL, np.zeros(3), PointToPointConfig(tau_m=tau_m))
    assert result.n_iterations == n_iterations
    assert result.residual_m == pytest.approx(0.0, abs=1e-12)


def test_equation_6_three_states_by_bayes_updates() -> None:
    # odds 7/3 of a hit: 49/58 after two; odds 2/3 of a beam across: 8/35 after three, 16/97 after four
    grid = OccupancyGrid(GridConfig(fill_gaps=False, resolution_m=0.1))
    end, across = np.array([[1.05, 0.05]]), np.array([[0.55, 0.05]])
    p = []
    for k in range(4):
        grid.update(k, np.array([0.05, 0.05]), end, np.full(1, True), np.full(1, True))
        p.append((float(grid.probability(end)[0]), float(grid.probability(across)[0])))
    np.testing.assert_allclose([p[1][0], p[2][1], p[3][1]], [49 / 58, 8 / 35, 16 / 97], rtol=1e-6)
    states = grid.config
    assert p[0][0] < states.p_occupied < p[1][0]
    assert p[3][1] < states.p_free < p[2][1]


def test_equation_7_end_points_of_the_beams() -> None:
    points = beams(2.0, 3.0, 2.0).points_base()
    np.testing.assert_allclose(points, [[math.sqrt(3), -1.0], [3.0, 0.0], [math.sqrt(3), 1.0]], atol=1e-12)


def test_equation_9_the_covariance_of_an_end_point() -> None:
    # 4 m ahead: along the beam 0.1^2 + 0.01^2, across it 0.1^2 + 4^2 (0.05^2 + 0.005^2)
    R_r = ConstantNoise().covariance(se2.IDENTITY)
    for heading, (x, y) in ((0.0, (0, 1)), (math.pi / 2, (1, 0))):
        T = np.array([0.5, -0.3, heading])
        cov = end_point_covariances(beams(4.0, 4.0, 4.0), T, R_r, EllipseTestConfig())[1]
        assert cov[x, x] == pytest.approx(0.0101)
        assert cov[y, y] == pytest.approx(0.0504)
        assert cov[0, 1] == pytest.approx(0.0, abs=1e-12)


def free_room(wall_x: float) -> OccupancyGrid:
    """All cells from -1 to 9 m seen free, but for a wall at one place of x, from -3 to 3 m of y."""
    grid = OccupancyGrid(GridConfig(fill_gaps=False, resolution_m=0.1))
    y = np.arange(-2.95, 3.0, 0.1)
    ends = np.column_stack([np.full(len(y), 9.0), y])
    for k in range(6):  # a scan changes a cell once: each has a number of its own
        for end in ends:
            origin = np.array([-1.0, end[1]])
            grid.update(2 * k, origin, end[None], np.full(1, True), np.full(1, False))
        for end in np.column_stack([np.full(len(y), wall_x), y]):
            grid.update(2 * k + 1, end - [0.2, 0.0], end[None], np.full(1, True), np.full(1, True))
    return grid


@pytest.mark.parametrize(("wall_x", "moves"), [(4.65, True), (4.15, False)])
def test_steps_2_to_4_a_point_moves_if_its_ellipse_covers_free_cells_only(wall_x: float, moves: bool) -> None:
    # the ellipse of the beam ahead reaches 4 m + 2.448 sqrt(0.0101) m = 4.246 m
    # the other two end on cells that nobody has seen
    scan, detector = beams(20.0, 4.0, 20.0), paper_detector("docpfo-every-scan")
    R_r = ConstantNoise().covariance(se2.IDENTITY)
    keep = ClusterConfig(min_points=1, split=None)
    found = detect_moving(
        scan, scan.is_valid(), np.zeros(3), R_r, free_room(wall_x), detector.ellipse_test, keep
    )
    assert found.is_moving.tolist() == [False, moves, False]


def test_step_5_subsets_that_are_too_small_or_too_wide_are_discarded() -> None:
    small = [[0.0, 0.0]]
    person = [[2.0, 0.0], [2.0, 0.3], [2.1, 0.5]]
    wall = [[5.0, 0.5 * k] for k in range(5)]  # 2 m
    points = np.array(small + person + wall)
    config = ClusterConfig(min_points=2, max_x_range_m=1.5, max_y_range_m=1.5, split=None)
    labels, n = find_clusters(points, np.full(len(points), True), config)
    assert n == 1
    assert labels.tolist() == [-1, 0, 0, 0, -1, -1, -1, -1, -1]


PLACE, PERSON = np.array([2.0, 0.0, 1.5]), (2.2, 1.6, 0.2)


ODOMETRY_ERROR = np.array([0.03, -0.02, 0.0])


def test_steps_1_to_7_in_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    matched_onto: list[BoolArray] = []
    with Pipeline(config_of("docpfo-every-scan")) as pipeline:
        match = pipeline.localizer.match

        def watched(points, is_static, kernel_factor=1.0, is_valid=None):  # type: ignore[no-untyped-def]
            matched_onto.append(is_static)
            return match(points, is_static, kernel_factor, is_valid)

        monkeypatch.setattr(pipeline.localizer, "match", watched)
        for k in range(10):
            pipeline.step(take_scan(PLACE, index=k))
        told = se2.compose(PLACE, ODOMETRY_ERROR)
        scan = take_scan(PLACE, index=10, discs=[PERSON], T_odom_base=told)
        is_valid, person = scan.is_valid(), is_person(scan)
        assert person.sum() > 5
        assert pipeline.grid is not None
        p_before = pipeline.grid.probability(scan.points_base()[person])
        step = pipeline.step(scan)
        p_after = pipeline.grid.probability(scan.points(step.T_map_base)[person])
    # 1: the pose by the odometry; 2 to 5: the test there, with the constant R_r
    np.testing.assert_allclose(step.T_map_base_predicted, ODOMETRY_ERROR, atol=1e-9)
    np.testing.assert_allclose(step.cov_relative, np.diag([0.1**2, 0.1**2, 0.05**2]))
    np.testing.assert_array_equal(step.is_moving, person)
    # 6: the match takes the static points alone, and gives the pose
    np.testing.assert_array_equal(matched_onto[-1], is_valid & ~person)
    np.testing.assert_allclose(step.T_map_base, np.zeros(3), atol=1e-3)
    # 7: the map takes all points, those that move included
    assert (p_before < 0.2).all()
    assert (p_after > p_before[: len(p_after)].min() * 1.5).all()
