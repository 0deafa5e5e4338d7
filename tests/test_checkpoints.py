"""When checkpoints are made, and what the folder holds then."""

from pathlib import Path

import numpy as np
import pytest

from slammot_graph.checkpoints import FIRST_AFTER_S, MOST_SHARE, Checkpoints
from slammot_graph.core.errors import InputError
from slammot_graph.core.frozen_state import FrozenRun
from slammot_graph.run import Run
from slammot_graph.run_folder.checkpoint import CHECKPOINT_FILE, CheckpointFile
from slammot_graph.run_folder.reader import read_run_folder
from slammot_graph.run_folder.writer import write_run_folder
from tests.rooms import drive


class Clock:
    """Time that passes as it is told to."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 0.0
        monkeypatch.setattr("time.monotonic", lambda: self.now_s)


def test_the_folder_holds_a_partial_run(tmp_path: Path) -> None:
    log = drive(30)
    run = Run(log)
    checkpoints = Checkpoints(run, CheckpointFile(tmp_path), tmp_path, every_s=60.0)
    for step in run:
        if step.scan.index == 19:
            checkpoints.write()
            folder = read_run_folder(tmp_path)
            assert len(folder.stamps) == 20
            assert folder.summary["is_complete"] is False
            assert folder.summary["n_scans"] == 20
            assert "--resume` goes on from it" in folder.summary["failures"][0]
            np.testing.assert_allclose(folder.T_map_base[-1], step.T_map_base, atol=1e-3)
            assert (tmp_path / "graph.g2o").exists()
    # being written has changed nothing
    np.testing.assert_array_equal(run.result().T_map_base, Run(log).complete().T_map_base)


def test_results_of_more_scans_give_way(tmp_path: Path) -> None:
    """As after a run that was killed while its end was written, and that goes on from its last checkpoint."""
    log = drive(12)
    write_run_folder(tmp_path, Run(log).complete())
    run = Run(log)
    next(iter(run))
    Checkpoints(run, CheckpointFile(tmp_path), tmp_path, every_s=60.0).write()
    folder = read_run_folder(tmp_path)
    assert len(folder.stamps) == 1
    assert folder.points is None


def test_they_take_a_small_share_of_the_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock, took_s, made_s = Clock(monkeypatch), 0.5, list[float]()
    run, file = Run(drive(2)), CheckpointFile(tmp_path)

    def write(_: FrozenRun) -> None:
        made_s.append(clock.now_s)
        clock.now_s += took_s

    monkeypatch.setattr(file, "write", write)
    checkpoints = Checkpoints(run, file, tmp_path, every_s=60.0)
    monkeypatch.setattr(checkpoints, "_write_partial_run", lambda: None)
    next(iter(run))
    for _ in range(40_000):
        clock.now_s += 0.01
        checkpoints.after_step()
    assert FIRST_AFTER_S <= made_s[0] < 1.0
    assert len(made_s) >= 5
    gaps_s = np.diff(made_s)
    assert (gaps_s >= took_s / MOST_SHARE - 0.1).all()
    assert gaps_s[-1] == pytest.approx(60.5, abs=0.1)


def test_there_may_be_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(monkeypatch)
    run = Run(drive(2))
    checkpoints = Checkpoints(run, CheckpointFile(tmp_path), tmp_path, every_s=0.0)
    for _ in run:
        clock.now_s += 1e9
        checkpoints.after_step()
        checkpoints.write()
    assert not list(tmp_path.iterdir())


def test_where_they_cannot_be_written_the_run_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, file = Run(drive(3)), CheckpointFile(tmp_path)
    checkpoints = Checkpoints(run, file, tmp_path, every_s=60.0)
    steps = iter(run)
    next(steps)
    checkpoints.write()
    n_written = 0

    def fail(_: FrozenRun) -> None:
        nonlocal n_written
        n_written += 1
        raise InputError("x: cannot be written (No space left on device)")

    monkeypatch.setattr(file, "write", fail)
    for _ in steps:
        checkpoints.write()
    assert n_written == 1
    assert "no checkpoints any more: x: cannot be written" in str(checkpoints.failure)
    assert not (tmp_path / CHECKPOINT_FILE).exists()
    assert run.is_complete
