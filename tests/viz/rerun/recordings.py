"""Recordings that the tests drive themselves, and what is read back from their files."""

from collections import Counter
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from slammot_graph import Run, get_method
from slammot_graph.core.config import to_plain
from slammot_graph.core.results import ClosureStatus, RunResult
from slammot_graph.core.types import FloatArray
from slammot_graph.observer import RunInfo
from slammot_graph.viz.rerun.run import RerunRecording
from tests.rooms import drive

N_SCANS = 40


def record(path: Path) -> RunResult:
    log, run = begin(path), Run(drive(N_SCANS))
    for step in run:
        log.log_step(step)
    result = run.result()
    log.on_finish(result)
    log.close()
    return result


def begin(path: Path) -> RerunRecording:
    """A recording that a test drives itself."""
    log = RerunRecording(path=path)
    log.on_start(RunInfo(method="graph", config=to_plain(get_method("graph").config)))
    return log


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


def all_entries(path: Path, entity: str, *components: str) -> list[tuple[Any, ...]]:
    """First instances of components of an entity, row by row, also where a scan has several."""
    from rerun.chunk import RrdReader

    found: list[tuple[Any, ...]] = []
    for chunk in RrdReader(path).stream().filter(content=entity):
        batch = chunk.to_record_batch()
        if not chunk.is_static and components[0] in batch.schema.names:
            columns = (batch.column(component).to_pylist() for component in components)
            found += [tuple(value[0] for value in row) for row in zip(*columns, strict=True)]
    return found


def strips(path: Path, entity: str) -> dict[int, list[FloatArray]]:
    """Line strips of an entity in the plane, by scan."""
    found = entries(path, entity, "LineStrips3D:strips")
    return {scan: [np.array(strip)[:, :2] for strip in lines] for scan, lines in found.items()}


def entity_of(status: ClosureStatus) -> str:
    return f"/world/closures/{status.replace(' ', '_')}"


def assert_same_results(result: RunResult, expected: RunResult) -> None:
    for f in fields(RunResult):
        a, b = getattr(result, f.name), getattr(expected, f.name)
        if isinstance(b, np.ndarray):
            np.testing.assert_array_equal(a, b, err_msg=f.name)
    np.testing.assert_array_equal(result.grid.p_occupied, expected.grid.p_occupied)
    for edge, other in zip(result.edges, expected.edges, strict=True):
        assert (edge.kind, edge.from_node, edge.to_node) == (other.kind, other.from_node, other.to_node)
        np.testing.assert_array_equal(edge.T_from_to, other.T_from_to)
        np.testing.assert_array_equal(edge.information, other.information)
