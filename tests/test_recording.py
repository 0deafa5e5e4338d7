"""The recording is read back from its file; not recording costs nothing, not even the import."""

import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import rerun as rr

from slammot_graph import Run, get_method
from slammot_graph.config import to_plain
from slammot_graph.errors import InputError
from slammot_graph.localization import ScanToMap
from slammot_graph.recording import NoRunLog, RerunLog
from slammot_graph.result_types import ClosureAttempt, ClosureStatus, GridMap, RunResult, StepResult
from slammot_graph.types import FloatArray
from tests.closure.ring import ring_log
from tests.rooms import drive

N_SCANS = 40


@pytest.fixture(autouse=True, scope="module")
def strict() -> Iterator[None]:
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


def record(path: Path) -> RunResult:
    config = get_method("graph").config
    log = RerunLog(path=path, method="graph", config=to_plain(config))
    run = Run(drive(N_SCANS), config=config)
    for step in run:
        log.log_step(step)
    result = run.result()
    log.finish(result)
    log.close()
    return result


def rows(path: Path) -> Counter[str]:
    from rerun.chunk import RrdReader

    counts: Counter[str] = Counter()
    for chunk in RrdReader(path).stream():
        counts[str(chunk.entity_path)] += chunk.num_rows
    return counts


def entries(path: Path, entity: str, component: str) -> dict[int, list[Any]]:
    """Instances of a component of an entity, by scan."""
    from rerun.chunk import RrdReader

    found: dict[int, list[Any]] = {}
    for chunk in RrdReader(path).stream().filter(content=entity):
        batch = chunk.to_record_batch()
        if not chunk.is_static and component in batch.schema.names:
            values = (value or [] for value in batch.column(component).to_pylist())
            found.update(zip(batch.column("scan").to_pylist(), values, strict=True))
    return found


def strips(path: Path, entity: str) -> dict[int, list[FloatArray]]:
    """Line strips of an entity in the plane, by scan."""
    found = entries(path, entity, "LineStrips3D:strips")
    return {scan: [np.array(strip)[:, :2] for strip in lines] for scan, lines in found.items()}


def entity_of(status: ClosureStatus) -> str:
    return f"/world/closures/{status.replace(' ', '_')}"


@dataclass
class Ring:
    """What a recorded run that closes loops did."""

    path: Path
    steps: list[StepResult] = field(default_factory=list)
    before: dict[int, FloatArray] = field(default_factory=dict)
    after: dict[int, FloatArray] = field(default_factory=dict)


@pytest.fixture(scope="module")
def ring(tmp_path_factory: pytest.TempPathFactory, strict: None) -> Ring:
    """A recording whose nodes were told at each closure that was accepted."""
    ring = Ring(tmp_path_factory.mktemp("ring") / "run.rrd")
    log, run = RerunLog(path=ring.path, method="graph", config={}), Run(ring_log(3))
    nodes = np.empty((0, 3))
    for step in run:
        log.log_step(step)
        ring.steps.append(step)
        assert log.wants_nodes == any(attempt.status == "accepted" for attempt in step.closures)
        assert isinstance(run.pipeline.localizer, ScanToMap)
        nodes_before = nodes
        if step.node is not None:
            nodes = run.pipeline.localizer.graph.poses()
        if log.wants_nodes:
            ring.before[step.scan.index], ring.after[step.scan.index] = nodes_before, nodes
            log.log_nodes(nodes)
    log.close()
    return ring


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


def test_a_recording_is_small(tmp_path: Path) -> None:
    record(tmp_path / "run.rrd")
    assert (tmp_path / "run.rrd").stat().st_size < 600_000 + N_SCANS * 11_000  # the layouts, and the scans


def test_a_folder_that_is_not_there_is_a_clear_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--rerun off"):
        RerunLog(path=tmp_path / "no" / "such" / "run.rrd", method="graph", config={})


def test_close_may_come_twice(tmp_path: Path) -> None:
    log = RerunLog(path=tmp_path / "run.rrd", method="graph", config={})
    log.close()
    log.close()


def test_off_means_off() -> None:
    log = NoRunLog()
    assert not log.wants_map
    assert not log.wants_graph
    assert not log.wants_nodes
    code = (
        "import sys; from slammot_graph.recording import NoRunLog; import slammot_graph; NoRunLog().close(); "
        "sys.exit('rerun' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_step_is_not_changed_by_recording(tmp_path: Path) -> None:
    log = RerunLog(path=tmp_path / "run.rrd", method="graph", config={})
    step = next(iter(Run(drive(5))))
    before = step.scan.ranges.copy()
    log.log_step(step)
    log.close()
    np.testing.assert_array_equal(step.scan.ranges, before)


def test_every_closure_that_was_tried_is_there_with_its_reason(ring: Ring) -> None:
    tried = [(step.scan.index, attempt) for step in ring.steps for attempt in step.closures]
    assert {attempt.status for _, attempt in tried} >= {"accepted", "refused"}
    for status in get_args(ClosureStatus):
        texts = entries(ring.path, entity_of(status), "LineStrips3D:labels")
        told = [(scan, text) for scan in sorted(texts) for text in texts[scan]]
        assert told == [(scan, attempt.text) for scan, attempt in tried if attempt.status == status]
        lines = strips(ring.path, entity_of(status))
        assert {k: len(v) for k, v in lines.items()} == {k: len(v) for k, v in texts.items()}
    refused = entries(ring.path, entity_of("refused"), "LineStrips3D:labels")
    reasons = [attempt.reason for _, attempt in tried if attempt.status == "refused"]
    assert all(reasons)
    assert all(reason in str(refused) for reason in reasons)


def test_a_closure_joins_the_places_of_its_nodes(ring: Ring) -> None:
    drawn = strips(ring.path, entity_of("accepted"))
    for step in ring.steps:
        accepted = [attempt for attempt in step.closures if attempt.status == "accepted"]
        for attempt, line in zip(accepted, drawn.get(step.scan.index, []), strict=True):
            ends = ring.before[step.scan.index][[attempt.target_node, attempt.source_node], :2]
            np.testing.assert_allclose(line, ends, atol=0.02)


def test_the_graph_is_there_before_and_after_a_closure(ring: Ring) -> None:
    before = strips(ring.path, "/world/closures/graph_before")
    after = strips(ring.path, "/world/closures/graph_after")
    assert set(before) == set(after) == set(ring.after)
    assert len(after) >= 5
    for scan, nodes in ring.after.items():
        (old,), (new,) = before[scan], after[scan]
        np.testing.assert_allclose(new, nodes[:, :2], atol=1e-5)
        np.testing.assert_allclose(old[:-1], ring.before[scan][:, :2], atol=0.03)
        way = np.diff(old[-2:], axis=0)  # the closing node has not jumped yet
        np.testing.assert_allclose(way, np.diff(new[-2:], axis=0), atol=0.02)
    first = min(after)
    assert np.hypot(*(after[first][0] - before[first][0]).T).max() > 0.05


def test_only_the_latest_attempts_are_drawn_each_with_its_status(tmp_path: Path) -> None:
    """Over several batches; a status without an attempt is cleared by the next step that tried any."""

    def attempt(status: ClosureStatus) -> ClosureAttempt:
        return ClosureAttempt(
            target_node=0, source_node=1, status=status, reason=f"so {status}", T_target_source=np.zeros(3)
        )

    steps = list(Run(drive(250)))
    tried: dict[int, tuple[ClosureStatus, ...]] = {
        40: ("refused", "waiting", "refused"),
        120: ("accepted", "taken back"),
        130: ("waiting",),
        210: ("taken back",),
    }
    log = RerunLog(path=tmp_path / "run.rrd", method="graph", config={})
    for k, step in enumerate(steps):
        log.log_step(replace(step, closures=tuple(attempt(status) for status in tried.get(k, ()))))
        assert log.wants_nodes == (k >= 120)  # nobody tells it the nodes
    log.close()
    expected = {
        "accepted": {120: 1, 130: 0},
        "waiting": {40: 1, 120: 0, 130: 1, 210: 0},
        "refused": {40: 2, 120: 0, 130: 0},
        "taken back": {120: 1, 130: 0, 210: 1},
    }
    for status in get_args(ClosureStatus):
        texts = entries(tmp_path / "run.rrd", entity_of(status), "LineStrips3D:labels")
        assert {scan: len(of_scan) for scan, of_scan in texts.items()} == expected[status]
        assert all(f"so {status}" in text for of_scan in texts.values() for text in of_scan)


def test_the_graph_before_and_after_waits_for_the_nodes(tmp_path: Path) -> None:
    """Where nobody tells the nodes at the closure, the next graph shows what it did."""
    closure = ClosureAttempt(
        target_node=0, source_node=1, status="accepted", reason="", T_target_source=np.zeros(3)
    )
    log, run = RerunLog(path=tmp_path / "run.rrd", method="graph", config={}), Run(drive(30))
    nodes: list[FloatArray] = []
    for k, step in enumerate(run):
        log.log_step(replace(step, closures=(closure,)) if k == 20 else step)
        if step.node is not None and k <= 20:
            nodes.append(step.T_map_base)
    log.finish(run.result())
    assert not log.wants_nodes
    log.close()
    ((scan, (before,)),) = strips(tmp_path / "run.rrd", "/world/closures/graph_before").items()
    assert scan == 29
    np.testing.assert_allclose(before, np.array(nodes)[:, :2], atol=1e-3)
    ((scan, (after,)),) = strips(tmp_path / "run.rrd", "/world/closures/graph_after").items()
    assert scan == 29
    np.testing.assert_allclose(after, run.result().nodes[: len(nodes), :2], atol=1e-5)


def test_a_point_tells_its_beam_its_probability_its_reason_and_its_ellipse(tmp_path: Path) -> None:
    from slammot_graph.motion import REASONS

    step = list(Run(drive(30)))[-1]
    p_moving = np.where(step.is_valid, np.linspace(0.0, 1.0, len(step.p_moving)), np.nan)
    step = replace(step, p_moving=p_moving, is_moving=p_moving > 0.75)
    log = RerunLog(path=tmp_path / "run.rrd", method="graph", config={})
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
    log = RerunLog(path=tmp_path / "run.rrd", method="graph", config={})
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
    log = RerunLog(path=tmp_path / "run.rrd", method="graph", config={})
    asked = []
    for k in range(2000):
        log.log_step(steps[-1])
        if log.wants_map:
            asked.append(k)
            log.log_map(GridMap(p_occupied=np.full((2, 2), 0.1), resolution_m=0.1, origin=np.zeros(2)))
    log.close()
    assert 20 <= len(asked) <= 45
    assert sum(asked) < 12 * 2000
