from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.results import StepResult
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.detection import reasons
from slammot_graph.detection.base import Detection
from slammot_graph.detection.ellipse_detector import EllipseDetectorConfig, RetestConfig
from slammot_graph.detection.ellipse_test import detect_moving
from slammot_graph.localization import ScanToMapConfig
from slammot_graph.mapping.occupancy_grid import GridConfig
from slammot_graph.pipeline import Pipeline, PipelineConfig
from tests.rooms import (
    LASER,
    ROOM,
    ListLog,
    cast,
    drive,
    errors,
    is_person,
    kidnapped,
    occluded,
    odometry_of,
    pipeline_config,
    truth_from_start,
)

GRAPH = PipelineConfig()
DOCPFO = pipeline_config("docpfo")


def run(log: ListLog, config: PipelineConfig = GRAPH) -> tuple[Pipeline, list[StepResult]]:
    """A pipeline after a log, to be closed, and its steps."""
    pipeline = Pipeline(config)
    steps = [pipeline.step(scan) for scan in log]
    return pipeline, steps


def true_pose(scan: Scan) -> FloatArray:
    assert scan.truth is not None
    assert scan.truth.T_world_base is not None
    return scan.truth.T_world_base


def recall_and_precision(steps: list[StepResult]) -> tuple[float, float]:
    truth = np.array([is_person(step.scan) for step in steps])
    found = np.array([step.is_moving for step in steps])
    return (truth & found).sum() / truth.sum(), (truth & found).sum() / max(found.sum(), 1)


def test_graph_localizes_and_finds_the_person() -> None:
    log = drive(100)
    pipeline, steps = run(log)
    truth = truth_from_start(log)
    assert max(errors(truth, np.array([step.T_map_base for step in steps]))) < 0.02
    final = pipeline.final()
    assert max(errors(truth, final.T_map_base)) < 0.015
    odometry = np.array([scan.T_odom_base for scan in log])
    assert errors(truth, se2.between(odometry[0], odometry))[0] > 0.1  # what there was to mend
    recall, precision = recall_and_precision(steps[20:])
    assert recall > 0.9
    assert precision > 0.95
    pipeline.close()


def test_the_person_is_tracked_where_he_walks() -> None:
    pipeline, steps = run(drive(100))
    start = pipeline.final().T_map_base[0]
    T_start = true_pose(steps[0].scan)
    np.testing.assert_allclose(start, 0.0, atol=1e-9)
    distances = []
    for step in steps[20:]:
        person = np.array([3.0 * np.sin(0.035 * step.scan.index - 1.0), 3.2])
        for track in step.tracks:
            position = se2.transform(T_start, track.position[None])[0]
            if len(track.beams):
                distances.append(np.linalg.norm(position - person))
                assert step.is_moving[track.beams].all()
    assert len(distances) > 30
    # the laser sees the near side of a disc of 0.25 m
    assert np.median(distances) < 0.3
    assert np.quantile(distances, 0.95) < 0.5
    pipeline.close()


def test_the_map_holds_the_walls_and_not_the_person() -> None:
    log = drive(100)
    pipeline, _ = run(log)
    rendered = pipeline.render_map()
    pipeline.close()
    rows, cols = np.nonzero(rendered.p_occupied > 0.65)
    centres = rendered.origin + rendered.resolution_m * (np.column_stack([cols, rows]) + 0.5)
    world = se2.transform(true_pose(log.scans[0]), centres)
    # distance to the nearest wall, by rays to all sides
    angles = np.linspace(-np.pi, np.pi, 72, endpoint=False)
    nothing = np.empty((0, 3))
    to_wall = np.array([cast(point, angles, ROOM, nothing)[0].min() for point in world])
    assert len(world) > 200
    assert np.mean(to_wall < 0.1) > 0.98


def test_moving_points_fill_the_map_only_if_asked_for() -> None:
    log = drive(38)
    quiet, ghostly = (
        run(log, replace(GRAPH, grid=GridConfig(occupy_with_moving=value)))[0] for value in (False, True)
    )
    last = log.scans[quiet.final().node_scans[-1]]
    place = last.points(quiet.final().nodes[-1])[is_person(last)]
    log_odds = []
    for pipeline in (quiet, ghostly):
        rendered = pipeline.render_map()
        i, j = np.floor((place - rendered.origin) / rendered.resolution_m).astype(int).T[::-1]
        p = rendered.p_occupied[i, j]
        log_odds.append(np.log(p / (1.0 - p)))
        pipeline.close()
    assert len(place) > 5
    assert np.median(log_odds[0]) < 0.0
    assert np.median(log_odds[1] - log_odds[0]) > 0.5


def test_first_scan_is_the_origin_and_all_static() -> None:
    pipeline, (step,) = run(drive(1))
    np.testing.assert_array_equal(step.T_map_base, np.zeros(3))
    assert step.node == 0
    assert step.match is None
    assert np.isnan(step.innovation_nis)
    assert not step.is_moving.any()
    assert set(step.reason) <= {reasons.UNKNOWN, reasons.NOT_VALID}
    assert len(pipeline.final().T_map_base) == 1
    pipeline.close()


def test_each_step_is_whole() -> None:
    pipeline, steps = run(drive(30))
    for step in steps:
        n = LASER.n_beams
        assert not (step.is_moving & ~step.is_valid).any()
        np.testing.assert_array_equal(np.isnan(step.p_moving), ~step.is_valid)
        np.testing.assert_array_equal(step.p_moving[step.is_valid] > 0.5, step.is_moving[step.is_valid])
        assert step.point_cov_map.shape == (n, 2, 2)
        assert np.linalg.eigvalsh(step.point_cov_map[step.is_valid]).min() > 0.0
        stages = {"predict", "detect", "match", "graph", "map", "objects"}
        assert stages <= set(step.stage_ms)
        assert step.stage_ms["step"] >= 0.95 * sum(step.stage_ms[name] for name in stages)
        assert np.linalg.eigvalsh(step.cov_map)[0] > 0.0
    assert np.isfinite([step.innovation_nis for step in steps[1:]]).all()
    pipeline.close()


def test_the_tests_covariance_is_the_one_asked_for() -> None:
    log = drive(12)
    relative = run(log, GRAPH)[1][-1]
    constant = run(log, pipeline_config("graph-fixed"))[1][-1]
    absolute = run(log, pipeline_config("graph-absolute"))[1][-1]
    np.testing.assert_allclose(constant.cov_relative, np.diag([0.01, 0.01, 0.0025]))
    assert np.trace(relative.cov_relative) < np.trace(constant.cov_relative)
    assert np.trace(absolute.cov_relative) >= np.trace(relative.cov_relative)


def test_docpfo_and_icp_differ_in_the_filter() -> None:
    log = drive(30)
    _, paper = run(log, pipeline_config("docpfo-every-scan"))
    _, icp = run(log, pipeline_config("icp-every-scan"))
    assert not any(step.is_moving.any() for step in icp)
    assert any(step.is_moving.any() for step in paper)
    for step in paper[1:]:
        assert step.match is not None
        assert step.match.status == "converged"
        assert step.node is None


def test_without_a_filter_nothing_moves() -> None:
    pipeline, steps = run(drive(40), pipeline_config("graph-nofilter"))
    assert not any(step.is_moving.any() for step in steps)
    assert not any(step.tracks for step in steps)
    pipeline.close()


def test_moving_points_are_left_out_of_the_match_and_of_the_occupied_cells(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pipeline, matched_masks, map_masks = Pipeline(GRAPH), [], []
    assert pipeline.detector.grid is not None
    match, add_scan = pipeline.localizer.match, pipeline.detector.grid.add_scan

    def spy_match(points: FloatArray, is_static: BoolArray, **rest: Any) -> object:
        matched_masks.append(is_static)
        return match(points, is_static, **rest)

    def spy_add(*scan_and_points: Any) -> None:
        map_masks.append(scan_and_points[-2:])
        add_scan(*scan_and_points)

    monkeypatch.setattr(pipeline.localizer, "match", spy_match)
    monkeypatch.setattr(pipeline.detector.grid, "add_scan", spy_add)
    steps = [pipeline.step(scan) for scan in drive(40)]
    pipeline.close()
    for step, (is_beam, is_hit) in zip(steps, map_masks, strict=True):
        np.testing.assert_array_equal(is_beam, step.is_valid)
        is_kept_out = np.isin(step.reason, reasons.NOT_MAPPED)
        np.testing.assert_array_equal(is_hit, step.is_valid & ~step.is_moving & ~is_kept_out)
    found = np.array([step.is_valid & ~mask for step, mask in zip(steps, matched_masks, strict=True)])
    truth = np.array([is_person(step.scan) for step in steps])
    assert (found & truth)[20:].sum() > 0.5 * truth[20:].sum()


@pytest.mark.parametrize("same_cells", [0.0, 0.2])
def test_the_test_is_repeated_at_the_matched_pose_unless_that_is_the_same(
    same_cells: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    poses: list[FloatArray] = []

    def spy(scan: Scan, is_valid: BoolArray, T_a_base: FloatArray, *others: Any) -> Detection:
        poses.append(T_a_base)
        return detect_moving(scan, is_valid, T_a_base, *others)

    monkeypatch.setattr("slammot_graph.detection.ellipse_detector.detect_moving", spy)
    detector = EllipseDetectorConfig(retest=RetestConfig(same_cells=same_cells))
    pipeline = Pipeline(PipelineConfig(detector=detector))
    first, second = (pipeline.step(scan) for scan in drive(2).scans)
    pipeline.close()
    assert first.match is None
    tested = [second.T_map_base_predicted, second.T_map_base]  # 7 mm apart
    np.testing.assert_allclose(poses[1:], tested if same_cells == 0.0 else tested[:1], atol=1e-3)
    assert not np.allclose(second.T_map_base_predicted, second.T_map_base, atol=2e-3)


def spoilt(log: ListLog, rng: np.random.Generator) -> ListLog:
    """One beam in eight is no measurement."""
    for scan in log:
        bad = rng.random(LASER.n_beams) < 0.125
        scan.ranges[bad] = rng.choice([np.nan, np.inf, -np.inf, -1.0, 0.0, 1e9], bad.sum())
    return log


@pytest.mark.parametrize("name", ["odometry", "icp", "docpfo", "graph", "graph-fixed", "graph-nofilter"])
def test_beams_that_are_no_measurements_are_borne(name: str, rng: np.random.Generator) -> None:
    pipeline, steps = run(spoilt(drive(15), rng), pipeline_config(name))
    assert np.isfinite([step.T_map_base for step in steps]).all()
    assert np.isfinite([step.cov_map for step in steps]).all()
    for step in steps:
        np.testing.assert_array_equal(step.is_valid, step.scan.is_valid())
        assert not (step.is_moving & ~step.is_valid).any()
    pipeline.close()


def test_spoilt_beams_do_not_mislead_the_graph(rng: np.random.Generator) -> None:
    log = spoilt(drive(60), rng)
    pipeline, _ = run(log)
    assert max(errors(truth_from_start(log), pipeline.final().T_map_base)) < 0.03
    pipeline.close()


def test_scans_of_different_lasers_may_follow_each_other() -> None:
    log = drive(40)
    half = replace(LASER, n_beams=91, angle_increment=2 * LASER.angle_increment)
    log.scans[1::2] = [replace(scan, laser=half, ranges=scan.ranges[::2].copy()) for scan in log.scans[1::2]]
    pipeline, steps = run(log)
    assert [len(step.is_moving) for step in steps[:4]] == [181, 91, 181, 91]
    assert max(errors(truth_from_start(log), pipeline.final().T_map_base)) < 0.03
    pipeline.close()


def test_an_occluded_laser_is_bridged_by_odometry() -> None:
    log = drive(60)
    for k in (30, 31):
        log.scans[k].ranges[:] = np.inf
    pipeline, steps = run(log)
    assert [step.match.status for step in steps[29:33] if step.match] == [
        "converged",
        "failed",
        "failed",
        "converged",
    ]
    assert np.isnan([step.innovation_nis for step in steps[30:32]]).all()
    assert not steps[30].is_valid.any()
    assert not steps[30].is_moving.any()
    assert max(errors(truth_from_start(log), pipeline.final().T_map_base)) < 0.03
    pipeline.close()


def test_stamps_may_run_backward() -> None:
    log = drive(50)
    log.scans[25:] = [replace(scan, stamp=scan.stamp - 50.0) for scan in log.scans[25:]]
    pipeline, steps = run(log)
    assert max(errors(truth_from_start(log), pipeline.final().T_map_base)) < 0.03
    assert all(np.isfinite(track.position).all() for step in steps for track in step.tracks)
    pipeline.close()


def test_a_jump_of_the_odometry_is_survived() -> None:
    log = drive(60)
    jump = np.array([2.0, 0.5, 0.0])
    log.scans[30:] = [
        replace(scan, T_odom_base=se2.compose(jump, odometry_of(scan))) for scan in log.scans[30:]
    ]
    pipeline, _ = run(log)
    final = pipeline.final()
    assert np.isfinite(final.T_map_base).all()
    assert np.isfinite(final.cov_map).all()
    truth = truth_from_start(log)
    # the path before the jump is right, and so is the path after it in itself
    assert errors(truth[:30], final.T_map_base[:30])[0] < 0.03
    after = se2.between(final.T_map_base[45], final.T_map_base[45:])
    assert errors(se2.between(truth[45], truth[45:]), after)[0] < 0.05
    # and so is the path across it: the jump is the odometry's, not the robot's
    assert errors(truth, final.T_map_base)[0] < 0.05
    pipeline.close()


def test_after_failures_in_a_row_a_new_local_map_begins() -> None:
    pipeline, steps = run(kidnapped(drive(40), 25), PipelineConfig(localizer=ScanToMapConfig(n_lost=3)))
    told = {step.scan.index: step.events for step in steps if step.events}
    assert [len(events) for events in told.values()] == [1, 1, 2, 1]
    last = min(told) + 2
    assert told[max(told)][0].kind == "recovered"
    assert min(told) == 25
    assert told[last][1].text == "lost: 3 matches failed in a row, a new local map begins here"
    assert steps[last].node is not None
    after = steps[last + 1].match
    assert after is not None
    assert after.status == "converged"
    assert np.isfinite(pipeline.final().T_map_base).all()
    pipeline.close()


def test_an_occluded_laser_loses_nothing_however_long() -> None:
    log = occluded(drive(60), *range(30, 45))
    pipeline, steps = run(log, PipelineConfig(localizer=ScanToMapConfig(n_lost=3)))
    assert [step.scan.index for step in steps if step.events] == list(range(30, 45))
    texts = [event.text for step in steps[30:45] for event in step.events]
    assert texts == 15 * ["match failed: only 0 points found a partner"]
    assert all(step.node is None for step in steps[30:45])
    truth = truth_from_start(log)
    assert max(errors(truth[45:], pipeline.final().T_map_base[45:])) < 0.03
    pipeline.close()


def test_farther_returns_are_left_aside() -> None:
    pipeline, steps = run(drive(5), replace(GRAPH, max_range_m=3.0))
    for step in steps:
        assert 0 < step.is_valid.sum() < LASER.n_beams
        assert step.scan.ranges[step.is_valid].max() < 3.0
    pipeline.close()


def test_a_pipeline_closes_itself() -> None:
    with Pipeline(GRAPH) as pipeline:
        assert [pipeline.step(scan).scan.index for scan in drive(2)] == [0, 1]
    with pytest.raises(ValueError, match="closed"):
        pipeline.step(drive(3).scans[2])


def test_a_method_without_a_test_has_no_grid_to_crop() -> None:
    for name in ("graph-nofilter", "icp", "odometry"):
        with Pipeline(pipeline_config(name)) as pipeline:
            assert pipeline.detector.grid is None
            with pytest.raises(ValueError, match="makes no test"):
                pipeline.crop_test_grid(np.zeros(2), 1.0)


def test_the_paper_tests_the_map_itself() -> None:
    with Pipeline(DOCPFO) as pipeline:
        assert pipeline.grid is not None
        assert pipeline.detector.grid is pipeline.grid
    with Pipeline(GRAPH) as pipeline:
        assert pipeline.grid is None
