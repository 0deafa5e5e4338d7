"""Nodes, edges and closures of the pose graph as they are recorded."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from slammot_graph import Run
from slammot_graph.core.results import ClosureAttempt, ClosureStatus, StepResult
from slammot_graph.core.types import FloatArray
from slammot_graph.localization import ScanToMap
from slammot_graph.pipeline import Pipeline
from tests.loop_closure.ring import ring_log
from tests.rooms import drive
from tests.viz.rerun.recordings import begin, entity_of, entries, rows, strips


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
    log, run = begin(ring.path), Run(ring_log(3))
    nodes = np.empty((0, 3))
    for step in run:
        log.log_step(step)
        ring.steps.append(step)
        assert log.wants_nodes() == any(attempt.status == "accepted" for attempt in step.closures)
        assert isinstance(run.pipeline, Pipeline)
        assert isinstance(run.pipeline.localizer, ScanToMap)
        nodes_before = nodes
        if step.node is not None:
            nodes = run.pipeline.localizer.graph.poses()
        if log.wants_nodes():
            ring.before[step.scan.index], ring.after[step.scan.index] = nodes_before, nodes
            log.log_nodes(nodes)
    log.close()
    return ring


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
    after = strips(ring.path, "/world/estimate/graph_path")
    assert set(before) == set(after) == set(ring.after)
    assert len(after) >= 5
    for scan, nodes in ring.after.items():
        (old,), (new,) = before[scan], after[scan]
        np.testing.assert_allclose(new, nodes[:, :2], atol=1e-5)
        np.testing.assert_allclose(old[:-1], ring.before[scan][:, :2], atol=0.03)
        path = np.diff(old[-2:], axis=0)  # the closing node has not jumped yet
        np.testing.assert_allclose(path, np.diff(new[-2:], axis=0), atol=0.02)
    first = min(after)
    assert np.hypot(*(after[first][0] - before[first][0]).T).max() > 0.03


def test_closures_of_the_graph_follow_its_nodes(ring: Ring) -> None:
    """Each closure moves those before it."""
    drawn = strips(ring.path, "/world/graph/closure")
    accepted: list[tuple[int, int]] = []
    assert set(drawn) == set(ring.after)
    for step in ring.steps:
        of_step = [attempt for attempt in step.closures if attempt.status == "accepted"]
        assert all(attempt.status != "outlier" for attempt in step.closures)
        accepted += [(attempt.target_node, attempt.source_node) for attempt in of_step]
        if of_step:
            nodes = ring.after[step.scan.index]
            np.testing.assert_allclose(drawn[step.scan.index], nodes[accepted][..., :2], atol=1e-5)


def test_a_closure_that_is_rejected_is_no_longer_drawn(tmp_path: Path) -> None:
    def attempt(source: int, status: ClosureStatus) -> ClosureAttempt:
        return ClosureAttempt(
            target_node=0, source_node=source, status=status, reason="", T_target_source=np.zeros(3)
        )

    tried = {40: [attempt(1, "accepted")], 60: [attempt(2, "accepted"), attempt(1, "outlier")]}
    log, run = begin(tmp_path / "run.rrd"), Run(drive(70))
    for k, step in enumerate(run):
        log.log_step(replace(step, closures=tuple(tried.get(k, ()))))
        if log.wants_nodes():
            nodes = run.pipeline.nodes_and_edges()[0]
            log.log_nodes(nodes)
    log.close()
    drawn = strips(tmp_path / "run.rrd", "/world/graph/closure")
    assert {k: len(lines) for k, lines in drawn.items()} == {40: 1, 60: 1}
    np.testing.assert_allclose(drawn[60][0], nodes[[0, 2], :2], atol=1e-5)


def test_the_graph_view_joins_nodes_that_it_has(ring: Ring) -> None:
    """An edge to a node of another entity would make a node of its own, somewhere."""
    log, run = begin(ring.path.with_name("graph.rrd")), Run(ring_log(3))
    for step in run:
        log.log_step(step)
    result = run.result()
    log.on_finish(result)
    log.close()
    path = ring.path.with_name("graph.rrd")
    assert [name for name in rows(path) if name.startswith("/graph/")] == ["/graph/chain"]
    (names,) = entries(path, "/graph/chain", "GraphNodes:node_ids").values()
    (edges,) = entries(path, "/graph/chain", "GraphEdges:edges").values()
    ends = {(edge["first"], edge["second"]) for edge in edges}
    closures = {(str(e.from_node), str(e.to_node)) for e in result.edges if e.kind == "closure"}
    assert len(closures) >= 5
    assert closures <= ends
    assert {end for edge in ends for end in edge} <= set(names)


def test_only_the_latest_attempts_are_drawn_each_with_its_status(tmp_path: Path) -> None:
    """Over several batches; a status without an attempt is cleared by the next step that tried any."""

    def attempt(status: ClosureStatus) -> ClosureAttempt:
        return ClosureAttempt(
            target_node=0, source_node=1, status=status, reason=f"so {status}", T_target_source=np.zeros(3)
        )

    steps = list(Run(drive(250)))
    tried: dict[int, tuple[ClosureStatus, ...]] = {
        40: ("refused", "waiting", "refused"),
        120: ("accepted", "outlier"),
        130: ("waiting",),
        210: ("outlier",),
    }
    log = begin(tmp_path / "run.rrd")
    for k, step in enumerate(steps):
        log.log_step(replace(step, closures=tuple(attempt(status) for status in tried.get(k, ()))))
        assert log.wants_nodes() == (k >= 120)  # nobody tells it the nodes
    log.close()
    expected = {
        "accepted": {120: 1, 130: 0},
        "waiting": {40: 1, 120: 0, 130: 1, 210: 0},
        "refused": {40: 2, 120: 0, 130: 0},
        "outlier": {120: 1, 130: 0, 210: 1},
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
    log, run = begin(tmp_path / "run.rrd"), Run(drive(30))
    nodes: list[FloatArray] = []
    for k, step in enumerate(run):
        log.log_step(replace(step, closures=(closure,)) if k == 20 else step)
        if step.node is not None and k <= 20:
            nodes.append(step.T_map_base)
    log.on_finish(run.result())
    assert not log.wants_nodes()
    log.close()
    ((scan, (before,)),) = strips(tmp_path / "run.rrd", "/world/closures/graph_before").items()
    assert scan == 29
    np.testing.assert_allclose(before, np.array(nodes)[:, :2], atol=1e-3)
    ((scan, (after,)),) = strips(tmp_path / "run.rrd", "/world/estimate/graph_path").items()
    assert scan == 29
    np.testing.assert_allclose(after, run.result().nodes[:, :2], atol=1e-5)
