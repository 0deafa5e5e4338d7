"""The recording is read back from its file; not recording costs nothing, not even the import."""

import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from slammot_graph import Run, get_method
from slammot_graph.config import to_plain
from slammot_graph.errors import InputError
from slammot_graph.recording import NoRunLog, RerunLog
from slammot_graph.result_types import RunResult
from tests.rooms import drive

N_SCANS = 40


@pytest.fixture(autouse=True)
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
    assert (tmp_path / "run.rrd").stat().st_size < N_SCANS * 20_000


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
