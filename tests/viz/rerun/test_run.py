"""The recording is read back from its file; not recording costs nothing, not even the import."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from slammot_graph import Run
from slammot_graph.core.errors import InputError
from slammot_graph.core.events import make_event
from slammot_graph.core.results import GridMap
from slammot_graph.viz.rerun import layout
from slammot_graph.viz.rerun.run import RerunRecording
from tests.loop_closure.ring import ring_log
from tests.rooms import drive
from tests.viz.rerun.recordings import N_SCANS, assert_same_results, begin, entries, record, rows


def test_a_recording_holds_scan_map_graph_plots_and_config(tmp_path: Path) -> None:
    result = record(tmp_path / "run.rrd")
    counts = rows(tmp_path / "run.rrd")
    assert counts["/world/map/grid"] >= 1
    assert counts["/world/graph/nodes"] >= 1
    assert counts["/doc/config"] >= 1
    plots = [name for name in counts if name.startswith("/plots/")]
    assert any("timing" in name for name in plots)
    assert any("count" in name for name in plots)
    assert max(counts[name] for name in plots) >= N_SCANS
    points = [name for name in counts if name.startswith("/world/") and counts[name] >= N_SCANS]
    assert points, counts
    assert result.is_complete


def test_a_recording_carries_its_layout(tmp_path: Path) -> None:
    from rerun.chunk import RrdReader

    record(tmp_path / "run.rrd")
    reader = RrdReader(tmp_path / "run.rrd")
    assert len(reader.recordings()) == 1
    assert len(reader.blueprints()) >= 1


def test_a_short_run_has_its_map_and_graph(tmp_path: Path) -> None:
    """Also before the first scans are sent."""
    Run(drive(60), observers=[RerunRecording(path=tmp_path / "run.rrd")]).complete()
    for entity, component in (
        ("/world/map/grid", "GridMap:cell_size"),
        ("/world/graph/nodes", "Points3D:positions"),
        ("/world/estimate/graph_path", "LineStrips3D:strips"),
    ):
        of_scan = set(entries(tmp_path / "run.rrd", entity, component))
        assert max(of_scan - {59}) >= 40  # the last is that of the finished run


@pytest.mark.parametrize(
    ("nis", "top"), [([], 10.0), ([np.nan], 10.0), ([1.0, np.nan], 10.0), ([15.0], 16.5), ([900.0], 20.0)]
)
def test_plots_end_above_most_of_their_values(nis: list[float], top: float, tmp_path: Path) -> None:
    result = replace(record(tmp_path / "run.rrd"), nis=np.array(nis))
    tops = layout.plot_tops(result)
    assert tops["nis"] == pytest.approx(top)
    assert tops["count"] == pytest.approx(1.4 * result.is_valid.sum(axis=1).max())
    assert np.nanmedian(result.stage_ms["step"]) < tops["timing"]
    without = layout.plot_tops(replace(result, stage_ms={}, is_valid=np.zeros((0, 0), dtype=bool)))
    assert set(without) == {"nis"}


def test_events_name_their_scan_and_are_as_loud_as_they_are_serious(tmp_path: Path) -> None:
    told = {
        5: (make_event("closure refused", 5, target_node=1, source_node=9, reason="no pose agrees"),),
        7: (make_event("match failed", 7, reason="so it is"),),
        8: (make_event("lost", 8, cause="kidnapped", n_scans=8),),
    }
    log = begin(tmp_path / "run.rrd")
    for k, step in enumerate(Run(drive(10))):
        log.log_step(replace(step, events=told.get(k, ())))
    log.close()
    texts = entries(tmp_path / "run.rrd", "/log/events", "TextLog:text")
    assert texts == {k: [f"scan {k}: {event.text}" for event in events] for k, events in told.items()}
    levels = entries(tmp_path / "run.rrd", "/log/events", "TextLog:level")
    assert levels == {5: ["INFO"], 7: ["WARN"], 8: ["ERROR"]}


def test_a_recording_is_small(tmp_path: Path) -> None:
    record(tmp_path / "run.rrd")
    assert (tmp_path / "run.rrd").stat().st_size < 750_000 + N_SCANS * 11_000  # the layouts, and the scans


def test_a_folder_that_is_not_there_is_a_clear_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--rerun off"):
        begin(tmp_path / "no" / "such" / "run.rrd")


def test_close_may_come_twice(tmp_path: Path) -> None:
    log = begin(tmp_path / "run.rrd")
    log.close()
    log.close()


def test_rerun_is_imported_only_when_a_recording_begins() -> None:
    code = (
        "import sys; from slammot_graph.viz.rerun.run import RerunRecording; import slammot_graph; "
        "slammot_graph.Run([]); RerunRecording(path='run.rrd').close(); sys.exit('rerun' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_step_is_not_changed_by_recording(tmp_path: Path) -> None:
    log = begin(tmp_path / "run.rrd")
    step = next(iter(Run(drive(5))))
    before = step.scan.ranges.copy()
    log.log_step(step)
    log.close()
    np.testing.assert_array_equal(step.scan.ranges, before)


def test_a_point_tells_its_beam_its_probability_its_reason_and_its_ellipse(tmp_path: Path) -> None:
    from slammot_graph.detection.reasons import REASONS

    step = list(Run(drive(30)))[-1]
    p_moving = np.where(step.is_valid, np.linspace(0.0, 1.0, len(step.p_moving)), np.nan)
    step = replace(step, p_moving=p_moving, is_moving=p_moving > 0.75)
    log = begin(tmp_path / "run.rrd")
    log.log_step(step)
    log.close()
    semi_mm = 2448.0 * np.sqrt(np.linalg.eigvalsh(step.point_cov_map))
    k = step.scan.index
    for entity, beams in (
        ("/world/robot/scan", np.flatnonzero(step.is_valid)),
        ("/world/ellipses/moving", np.flatnonzero(step.is_moving)),
    ):
        told = {
            name: entries(tmp_path / "run.rrd", entity, name)[k]
            for name in ("beam", "p_moving", "reason", "ellipse_long_mm", "ellipse_short_mm")
        }
        assert told["beam"] == beams.tolist()
        np.testing.assert_allclose(told["p_moving"], p_moving[beams], atol=6e-4)
        assert told["reason"] == [REASONS[code] for code in step.reason[beams]]
        np.testing.assert_allclose(told["ellipse_long_mm"], semi_mm[beams, 1], atol=1.0)
        np.testing.assert_allclose(told["ellipse_short_mm"], semi_mm[beams, 0], atol=1.0)
    classes = entries(tmp_path / "run.rrd", "/world/robot/scan", "Points3D:class_ids")[k]
    expected = np.where(p_moving > 0.75, 2, np.where(p_moving > 0.5, 3, 1))[step.is_valid]
    assert classes == expected.tolist()


def test_the_anchor_is_drawn_where_it_changes(tmp_path: Path) -> None:
    steps = list(Run(drive(250)))
    log = begin(tmp_path / "run.rrd")
    for step in steps:
        log.log_step(step)
    log.close()
    labels = entries(tmp_path / "run.rrd", "/world/anchor", "Points3D:labels")
    before = [-1, *(step.anchor_scan for step in steps)]
    changed = [k for k, step in enumerate(steps) if step.anchor_scan != before[k]]
    assert len(changed) >= 2
    assert {k: text for k, text in labels.items() if text} == {
        k: [f"scan {steps[k].anchor_scan}"] for k in changed
    }
    places = entries(tmp_path / "run.rrd", "/world/anchor", "Points3D:positions")
    for k in changed:
        np.testing.assert_allclose(places[k][0][:2], steps[steps[k].anchor_scan].T_map_base[:2], atol=0.05)


def test_maps_are_asked_for_less_often_in_a_longer_run(tmp_path: Path) -> None:
    """Their number grows with the logarithm of the run, so that rendering them costs a fixed time a scan."""
    steps = list(Run(drive(30)))
    log = begin(tmp_path / "run.rrd")
    asked = []
    for k in range(2000):
        log.log_step(steps[-1])
        if log.wants_map():
            asked.append(k)
            log.log_map(GridMap(p_occupied=np.full((2, 2), 0.1), resolution_m=0.1, origin=np.zeros(2)))
    log.close()
    assert 20 <= len(asked) <= 45
    assert sum(asked) < 12 * 2000


def test_recording_does_not_change_the_estimate(tmp_path: Path) -> None:
    """What the recording asks the graph must not move it: the same numbers with and without, to the last bit."""
    plain = Run(ring_log(3)).complete()
    recorded = Run(ring_log(3), observers=[RerunRecording(path=tmp_path / "run.rrd")]).complete()
    assert sum(edge.kind == "closure" for edge in plain.edges) >= 5
    assert_same_results(recorded, plain)


class FullDisk:
    """What `shutil.disk_usage` says, from the k-th question on, of a disk that is nearly full."""

    def __init__(self, k: int) -> None:
        self.n_left = k

    def __call__(self, _: Path) -> SimpleNamespace:
        self.n_left -= 1
        return SimpleNamespace(free=1 << 40 if self.n_left >= 0 else 20 << 20)


@pytest.mark.parametrize("k", [0, 1, 2, 3])
def test_a_full_disk_ends_the_recording_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, k: int
) -> None:
    monkeypatch.setattr("slammot_graph.viz.rerun.run.SCANS_PER_SEND", 10)
    monkeypatch.setattr("shutil.disk_usage", FullDisk(k))
    plain, run = Run(drive(30)), Run(drive(30), observers=[RerunRecording(path=tmp_path / "run.rrd")])
    steps = []
    with pytest.raises(InputError, match=r"the recording ends after \d+ scans.*20 MB are free") as caught:
        for step in run:
            steps.append(step)  # noqa: PERF402 - the error comes after the last
    assert "--rerun off" in str(caught.value)
    assert len(steps) == 30
    assert run.is_complete
    assert run.result().is_complete
    assert_same_results(run.result(), plain.complete())
    assert (tmp_path / "run.rrd").exists() == (k > 0)


def test_an_error_of_a_recording_is_told_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("out of colours")

    monkeypatch.setattr(RerunRecording, "log_map", fail)
    recording = RerunRecording(path=tmp_path / "run.rrd")
    run = Run(drive(10), observers=[recording])
    with pytest.raises(InputError, match="out of colours"):
        run.complete()
    assert len(run.result().stamps) == 10
    recording.close()
