import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slammot_graph.baselines.kiss_icp import KissIcpPipeline
from slammot_graph.core import se2
from slammot_graph.core.config import to_plain
from slammot_graph.core.errors import ConfigError, InputError, SlammotError
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import FloatArray
from slammot_graph.detection.no_detection import NoDetectionConfig
from slammot_graph.graph import PoseGraph
from slammot_graph.localization import ScanToMapConfig
from slammot_graph.logs.source import SkippedScan
from slammot_graph.mapping.tiled_grid import TiledGrid
from slammot_graph.methods import METHODS
from slammot_graph.pipeline import Pipeline, PipelineConfig
from slammot_graph.registration.point_to_line import PointToLineConfig
from slammot_graph.run import Run, make_pipeline
from slammot_graph.run_folder.writer import write_run_folder
from tests.rooms import LASER, ListLog, drive, errors, kidnapped, occluded, truth_from_start


def test_steps_come_one_by_one_and_the_result_at_the_end() -> None:
    log = drive(20)
    run = Run(log)
    steps = list(run)
    result = run.result()
    assert [step.scan for step in steps] == log.scans
    assert result.is_complete
    assert (result.method, result.config) == ("graph", to_plain(METHODS["graph"].config))
    np.testing.assert_array_equal(result.stamps, [scan.stamp for scan in log])
    np.testing.assert_array_equal(result.is_moving_online, [step.is_moving for step in steps])
    np.testing.assert_array_equal(result.is_valid, [step.is_valid for step in steps])
    np.testing.assert_array_equal(result.nis, [step.innovation_nis for step in steps])
    np.testing.assert_array_equal(result.node_scans, [s.scan.index for s in steps if s.node is not None])
    for name, times in result.stage_ms.items():
        np.testing.assert_allclose(times, [step.stage_ms[name] for step in steps], rtol=1e-6)
    assert result.n_failed_matches == 0
    assert result.events == ()


def test_raw_odometry_starts_where_the_trajectory_does() -> None:
    log = drive(20)
    result = Run(log).complete()
    np.testing.assert_allclose(result.T_map_odom_base[0], result.T_map_base[0], atol=1e-9)
    odometry = np.array([scan.T_odom_base for scan in log])
    np.testing.assert_allclose(
        se2.between(result.T_map_odom_base[3], result.T_map_odom_base[-1]),
        se2.between(odometry[3], odometry[-1]),
        atol=1e-9,
    )


@pytest.mark.parametrize("method", ["graph", "docpfo"])
def test_moving_points_are_those_of_the_final_labels(method: str) -> None:
    log = drive(60)
    result = Run(log, method).complete()
    expected = [
        scan.points(T)[is_moving]
        for scan, T, is_moving in zip(log, result.T_map_base, result.is_moving, strict=True)
    ]
    assert len(result.moving_points) > 20
    np.testing.assert_allclose(result.moving_points, np.concatenate(expected), atol=1e-5)


def test_tracks_are_rows_of_plain_numbers() -> None:
    run, rows, is_seen = Run(drive(60)), [], []
    for step in run:
        for track in step.tracks:
            (xx, xy), (_, yy) = track.position_cov
            place = [*track.position, *track.velocity, xx, xy, yy]
            rows.append([step.scan.stamp, track.track_id, *place, step.scan.index])
            is_seen.append(len(track.beams) > 0)
    assert len(rows) > 10
    np.testing.assert_array_equal(run.result().tracks_online, rows)
    np.testing.assert_array_equal(run.result().is_track_online_seen, is_seen)
    assert set(is_seen) == {True, False}


@pytest.mark.parametrize("n", [1, 12])
@pytest.mark.parametrize("method", ["graph", "docpfo"])
def test_an_interrupted_run_has_a_valid_partial_result(method: str, n: int) -> None:
    run, short = Run(drive(30), method), Run(drive(n), method).complete()
    for k, _ in enumerate(run, start=1):
        if k == n:
            break
    result = run.result()
    assert not result.is_complete
    assert short.is_complete
    for name in (
        "stamps",
        "T_map_base",
        "cov_map",
        "is_valid",
        "is_moving",
        "p_moving",
        "nodes",
        "node_scans",
    ):
        np.testing.assert_array_equal(getattr(result, name), getattr(short, name))
    np.testing.assert_array_equal(result.grid.p_occupied, short.grid.p_occupied)


def test_an_interrupted_run_of_kiss_icp_has_a_partial_result_too() -> None:
    run = Run(drive(30), "kiss-icp")
    for k, _ in enumerate(run, start=1):
        if k == 12:
            break
    result = run.result()
    assert not result.is_complete
    assert result.T_map_base.shape == (12, 3)
    assert result.cov_map.shape == (12, 3, 3)


def test_an_error_on_the_way_leaves_a_partial_result() -> None:
    log = drive(10)
    run = Run(log)

    class StopError(Exception):
        pass

    def fail() -> None:
        for k, _ in enumerate(run):
            if k == 5:
                raise StopError

    with pytest.raises(StopError):
        fail()
    assert len(run.result().stamps) == 6


def test_a_graph_that_fails_tells_its_first_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail_later(graph: PoseGraph) -> None:
        if len(graph) >= 1:
            raise SlammotError("the first error")
        update(graph)

    def fail_too(graph: PoseGraph) -> FloatArray:
        raise SlammotError(f"the second error, of {len(graph)} nodes")

    update = PoseGraph.update
    monkeypatch.setattr(PoseGraph, "update", fail_later)
    monkeypatch.setattr(PoseGraph, "poses", fail_too)
    with pytest.raises(SlammotError, match="the first error"):
        Run(drive(20)).complete()


def test_a_match_that_determines_nothing_is_a_failure_not_an_error(rng: np.random.Generator) -> None:
    log = drive(20)
    for scan in log.scans[1:]:
        bad = rng.random(LASER.n_beams) < 0.6
        scan.ranges[bad] += rng.uniform(0.1, 0.35, bad.sum())
    localizer = ScanToMapConfig(n_lost=100, point_to_line=PointToLineConfig(weak_ratio=0.29))
    config = PipelineConfig(localizer=localizer, detector=NoDetectionConfig())
    result = Run(log, config=config).complete()
    assert any(event.text == "match failed: no direction is determined" for event in result.events)
    assert len(result.nodes) >= 2
    assert np.isfinite(result.T_map_base).all()
    assert errors(truth_from_start(log), result.T_map_base)[0] < 0.2


def test_a_run_may_be_run_again() -> None:
    run = Run(drive(15))
    first, second = run.complete(), run.complete()
    np.testing.assert_array_equal(first.T_map_base, second.T_map_base)
    assert len(second.stamps) == 15


def test_a_log_without_a_usable_scan_is_an_error_that_names_it() -> None:
    log = ListLog([], skipped=[SkippedScan(place=f"line {k}", reason="no beam") for k in range(1, 6)])
    run = Run(log)
    text = r"list.log: none of its 5 scans is usable \(line 1: no beam; line 2: no beam; line 3: no beam\)"
    with pytest.raises(InputError, match=text):
        run.complete()
    result = run.result()
    assert not result.is_complete
    assert len(result.T_map_base) == len(result.stamps) == 0
    assert result.n_skipped == 5


def test_scans_of_different_lasers_are_padded_with_beams_that_are_not_valid() -> None:
    log = drive(6)
    half = replace(LASER, n_beams=91, angle_increment=2 * LASER.angle_increment)
    log.scans[1] = replace(log.scans[1], laser=half, ranges=log.scans[1].ranges[::2].copy())
    result = Run(log).complete()
    for array in (result.is_valid, result.is_moving, result.is_moving_online, result.p_moving):
        assert array.shape == (6, 181)
    assert result.is_valid[1, :91].all()
    assert not result.is_valid[1, 91:].any()
    assert not result.is_moving[1, 91:].any()
    assert np.isnan(result.p_moving[1, 91:]).all()
    assert result.is_valid[[0, 2, 3, 4, 5]].all()


def test_failures_and_events_are_counted() -> None:
    log = occluded(kidnapped(drive(20), 9), 9)
    result = Run(log, config=PipelineConfig(localizer=ScanToMapConfig(n_lost=2))).complete()
    assert result.events[0].text == "match failed: only 0 points found a partner"
    assert [event.scan for event in result.events] == [9, 10, 11, 11, 16]
    assert [event.severity for event in result.events] == ["warning", "warning", "warning", "error", "info"]
    assert result.events[3].text == "lost: 2 matches failed in a row, a new local map begins here"
    assert (
        result.events[4].text == "recovered: the robot was lost, 5 scans ago; 5 matches in a row agree again"
    )
    lost = ["degenerate", "degenerate", *["lost"] * 5, "recovered"]
    np.testing.assert_array_equal(result.health, [*["healthy"] * 9, *lost, *["healthy"] * 3])
    assert [finding.kind for finding in result.verdict] == ["lost"]
    assert result.n_failed_matches == 3
    assert np.isnan(result.nis[9:12]).all()
    assert np.isfinite(result.nis[12:]).all()


def test_max_range_takes_the_place_of_the_configured_one() -> None:
    result = Run(drive(5), max_range_m=3.0).complete()
    assert result.config["max_range_m"] == 3.0
    ranges = np.array([scan.ranges for scan in drive(5)])
    np.testing.assert_array_equal(result.is_valid, ranges < 3.0)


def test_the_first_scans_alone_are_a_whole_run() -> None:
    log = drive(20)
    result = Run(log, max_scans=7).complete()
    assert result.is_complete
    np.testing.assert_array_equal(result.stamps, [scan.stamp for scan in log.scans[:7]])
    assert len(Run(log, max_scans=70).complete().stamps) == 20
    with pytest.raises(ConfigError, match="max_scans must be at least 1, not 0"):
        Run(log, max_scans=0)


def test_a_part_of_a_log_is_a_whole_run() -> None:
    part = drive(40).scans[15:]
    result = Run(part).complete()
    counted = Run([replace(scan, index=k) for k, scan in enumerate(part)]).complete()
    assert result.is_complete
    np.testing.assert_array_equal(result.T_map_base, counted.T_map_base)
    np.testing.assert_array_equal(result.grid.p_occupied, counted.grid.p_occupied)
    np.testing.assert_array_equal(result.is_moving, counted.is_moving)


def test_threads_end_with_the_run() -> None:
    def n_threads() -> int:
        return sum(thread.name.startswith("pose-graph") for thread in threading.enumerate())

    before = n_threads()
    Run(drive(3)).complete()
    for _ in Run(drive(3)):
        break
    assert n_threads() == before


def test_a_configuration_makes_its_pipeline() -> None:
    pipeline = make_pipeline(METHODS["graph"].config)
    assert isinstance(pipeline, Pipeline)
    pipeline.close()
    assert isinstance(make_pipeline(METHODS["kiss-icp"].config), KissIcpPipeline)


def test_each_iteration_has_a_result_of_its_own() -> None:
    """Once there were 10 stamps with 60 poses: the second run's scans with the first one's end."""
    run = Run(drive(20))
    first = run.complete()
    steps = iter(run)
    for _ in range(5):
        next(steps)
    result = run.result()
    for name in ("stamps", "T_map_base", "cov_map", "is_moving", "is_moving_online", "nis"):
        assert len(getattr(result, name)) == 5, name
    assert not result.is_complete
    others = iter(run)  # ends the one before
    next(others)
    assert len(run.result().T_map_base) == 1
    assert next(steps, None) is None
    again = run.complete()
    np.testing.assert_array_equal(again.T_map_base, first.T_map_base)
    assert again.is_complete


def test_a_result_is_there_at_any_time_and_does_not_change_the_run() -> None:
    assert len(Run(drive(3)).result().T_map_base) == 0
    plain, watched = Run(drive(60)), Run(drive(60))
    for k, _ in enumerate(watched, start=1):
        result = watched.result()
        assert result.T_map_base.shape == (k, 3)
        assert not result.is_complete
    expected = plain.complete()
    for name in ("T_map_base", "cov_map", "is_moving", "nodes", "tracks", "p_moving"):
        np.testing.assert_array_equal(getattr(watched.result(), name), getattr(expected, name))


def test_a_run_left_early_ends_with_its_context() -> None:
    with Run(drive(30)) as run:
        steps = iter(run)
        for _ in range(4):
            next(steps)
    assert next(steps, None) is None
    assert len(run.result().T_map_base) == 4
    run.close()


@pytest.mark.parametrize("method", ["graph", "docpfo", "odometry", "kiss-icp"])
def test_a_live_source_needs_no_length_and_is_read_once(method: str) -> None:
    log = drive(12)
    result = Run((scan for scan in log), method).complete()
    np.testing.assert_array_equal(result.stamps, [scan.stamp for scan in log])
    assert result.n_skipped == 0
    with pytest.raises(InputError, match="the source gave no usable scan"):
        Run(iter(())).complete()


@pytest.mark.parametrize(
    ("broken", "what"),
    [
        ("final", "optimised trajectory"),
        ("final_labels", "final labels"),
        ("render_map", "map"),
        ("moving_points", "moving points"),
    ],
)
def test_a_failing_end_keeps_what_was_computed_and_tells_why(
    broken: str, what: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fail(*_: object) -> None:
        raise OSError("no space left")

    plain = Run(drive(40)).complete()
    monkeypatch.setattr(Pipeline, broken, fail)
    run = Run(drive(40))
    steps = []
    with pytest.raises(OSError, match="no space left"):
        for step in run:
            steps.append(step)  # noqa: PERF402 - the error comes after the last
    monkeypatch.undo()
    result = run.result()
    assert result.failures == (f"{what}: no space left",)
    assert not result.is_complete
    assert run.is_complete
    kept_as_it_was = ["stamps", "is_valid", "is_moving_online", "tracks_online", "nis", "p_moving"]
    for name in kept_as_it_was + (["T_map_base", "cov_map", "nodes"] if broken != "final" else []):
        np.testing.assert_array_equal(getattr(result, name), getattr(plain, name), err_msg=name)
    if broken == "final":  # the poses of the time
        np.testing.assert_array_equal(result.T_map_base, [step.T_map_base for step in steps])
        np.testing.assert_array_equal(result.cov_map, [step.cov_map for step in steps])
    if broken == "final_labels":
        np.testing.assert_array_equal(result.is_moving, result.is_moving_online)
    assert np.isfinite(result.grid.p_occupied).any() == (broken != "render_map")
    write_run_folder(tmp_path / "run", result)  # also such a result can be written


def test_the_first_error_is_told_and_that_of_the_end_is_its_note(monkeypatch: pytest.MonkeyPatch) -> None:
    def source() -> Iterator[Scan]:
        yield from drive(5)
        raise InputError("cut short")

    def fail(*_: object) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(Pipeline, "render_map", fail)
    run = Run(source())
    with pytest.raises(InputError, match="cut short") as caught:
        run.complete()
    assert caught.value.__notes__ == ["at the end of the run: no space left"]
    assert len(run.result().stamps) == 5


def test_whoever_leaves_a_run_early_is_told_that_its_end_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(Pipeline, "render_map", fail)
    run = Run(drive(5))
    steps = iter(run)
    next(steps)
    with pytest.raises(OSError, match="no space left"):
        run.close()
    assert len(run.result().T_map_base) == 1


def test_a_map_too_large_gets_larger_cells_and_that_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = Run(drive(20)).complete()
    assert TiledGrid.to_map.__defaults__ is not None
    monkeypatch.setattr(TiledGrid.to_map, "__defaults__", (20_000,))
    result = Run(drive(20)).complete()
    assert result.is_complete
    assert [finding.kind for finding in result.verdict] == ["map resolution"]
    assert "cells of 0.2 m" in result.verdict[0].text
    assert result.grid.resolution_m > plain.grid.resolution_m
    np.testing.assert_array_equal(result.is_moving, plain.is_moving)
    np.testing.assert_array_equal(result.T_map_base, plain.T_map_base)
