from itertools import pairwise

import numpy as np
import pytest

from slammot_graph.baselines.kiss_icp import KissIcpConfig, KissIcpPipeline
from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.results import StepResult
from slammot_graph.odometry.noise import OdometryNoise
from tests.rooms import LASER, ListLog, drive, errors, occluded, odometry_of, truth_from_start


def run(log: ListLog, config: KissIcpConfig) -> tuple[KissIcpPipeline, list[StepResult]]:
    pipeline = KissIcpPipeline(config)
    return pipeline, [pipeline.step(scan) for scan in log]


@pytest.mark.parametrize("use_odometry", [False, True])
def test_kiss_icp_follows_the_robot(use_odometry: bool) -> None:
    log = drive(40, with_person=False)
    pipeline, steps = run(log, KissIcpConfig(use_odometry=use_odometry))
    final = pipeline.final()
    assert errors(truth_from_start(log), final.T_map_base)[0] < 0.12
    np.testing.assert_array_equal(final.T_map_base, [step.T_map_base for step in steps])
    np.testing.assert_array_equal(final.cov_map, [step.cov_map for step in steps])
    assert (final.nodes.shape, final.node_scans.shape, final.edges) == ((0, 3), (0,), ())
    assert (pipeline.render_map().p_occupied > 0.5).sum() > 100
    pipeline.close()


def test_a_run_twice_gives_the_same() -> None:
    log = drive(25)
    first, second = (run(log, KissIcpConfig())[0].final().T_map_base for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_nothing_moves_and_nothing_is_matched() -> None:
    _, steps = run(drive(5), KissIcpConfig())
    for step in steps:
        assert not step.is_moving.any()
        assert (step.match, step.node, step.tracks, step.events) == (None, None, (), ())
        assert step.stage_ms.keys() == {"step"}
        assert step.point_cov_map.shape == (LASER.n_beams, 2, 2)


def test_the_start_value_comes_from_the_odometry() -> None:
    log = drive(12, with_person=False)
    _, steps = run(log, KissIcpConfig(use_odometry=True))
    for before, step in pairwise(steps):
        increment = se2.between(odometry_of(before.scan), odometry_of(step.scan))
        predicted = se2.compose(before.T_map_base, increment)
        np.testing.assert_allclose(step.T_map_base_predicted, predicted, atol=1e-12)


def test_its_covariance_grows_with_the_way() -> None:
    _, steps = run(drive(20, with_person=False), KissIcpConfig())
    moved = se2.between(steps[4].T_map_base, steps[5].T_map_base)
    cov = se2.compound_covariance(steps[4].cov_map, moved, OdometryNoise().covariance(moved))
    np.testing.assert_allclose(steps[5].cov_map, cov)
    assert np.trace(steps[-1].cov_map) > np.trace(steps[5].cov_map)


def test_beams_that_are_no_measurements_are_borne(rng: np.random.Generator) -> None:
    log = drive(20, with_person=False)
    for scan in log:
        bad = rng.random(LASER.n_beams) < 0.125
        scan.ranges[bad] = rng.choice([np.nan, np.inf, -np.inf, -1.0, 0.0, 1e9], bad.sum())
    pipeline, _ = run(log, KissIcpConfig())
    assert errors(truth_from_start(log), pipeline.final().T_map_base)[0] < 0.12


@pytest.mark.parametrize("k", [0, 10])
def test_an_occluded_laser_is_bridged_by_odometry(k: int) -> None:
    log = drive(15, with_person=False)
    log.scans[k].ranges[:] = np.nan
    pipeline, steps = run(log, KissIcpConfig(use_odometry=True))
    np.testing.assert_array_equal(steps[k].T_map_base, steps[k].T_map_base_predicted)
    assert errors(truth_from_start(log), pipeline.final().T_map_base)[0] < 0.12


def test_a_laser_occluded_for_long_keeps_the_odometry_of_that_time() -> None:
    log = occluded(drive(30, with_person=False), *range(10, 18))  # 0.64 m
    pipeline, steps = run(log, KissIcpConfig(use_odometry=True))
    for before, step in pairwise(steps[9:18]):
        increment = se2.between(odometry_of(before.scan), odometry_of(step.scan))
        np.testing.assert_allclose(se2.between(before.T_map_base, step.T_map_base), increment, atol=1e-12)
    assert errors(truth_from_start(log), pipeline.final().T_map_base)[0] < 0.12


@pytest.mark.parametrize(
    "name",
    ["max_range_m", "min_range_m", "voxel_size_m", "fixed_threshold_m", "map_spacing_m", "match_spacing_m"],
)
@pytest.mark.parametrize("value", [0.0, float("nan")])
def test_impossible_settings_are_refused(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"{name} must be positive, not {value}"):
        KissIcpConfig(**{name: value})  # type: ignore[arg-type]


def test_a_voxel_needs_a_point() -> None:
    with pytest.raises(ConfigError, match="max_points_per_voxel must be at least 1, not 0"):
        KissIcpConfig(max_points_per_voxel=0)
