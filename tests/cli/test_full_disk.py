"""A run on a disk that is full: what was computed is written before anything else, and the cause is told."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from slammot_graph.cli import console, running
from slammot_graph.core.errors import InputError
from slammot_graph.core.results import RunResult
from slammot_graph.run_folder.reader import read_run_folder
from tests.cli.test_cli import N_SCANS, run, write_box_log


@pytest.fixture
def log(tmp_path: Path) -> Path:
    write_box_log(tmp_path / "box.npz")
    return tmp_path / "box.npz"


def full_for(write: object, n_times: int) -> object:
    """A writer that finds the disk full so many times."""
    n_left = n_times

    def write_run(result: RunResult, directory: Path) -> None:
        nonlocal n_left
        n_left -= 1
        if n_left >= 0:
            raise InputError("points.npz: cannot be written") from OSError(28, "No space left on device")
        write(result, directory)  # type: ignore[operator]

    return write_run


@pytest.mark.parametrize(("n_times", "is_written"), [(1, True), (2, False)])
def test_the_recording_gives_way_to_the_results(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    log: Path,
    tmp_path: Path,
    n_times: int,
    is_written: bool,
) -> None:
    from slammot_graph import saving

    monkeypatch.setattr(saving, "write_run", full_for(saving.write_run, n_times))
    code, _, err = run(capsys, "run", log, "--output", tmp_path / "out")
    assert code == console.EXIT_USER_ERROR
    assert ("run.rrd: removed, to make room for the results" in err) == is_written
    assert err.splitlines()[-1].startswith("slammot-graph: ")
    assert {path.name for path in (tmp_path / "out").iterdir()}.isdisjoint({"run.rrd", ".run.lock"})
    if is_written:
        assert len(read_run_folder(tmp_path / "out").stamps) == N_SCANS


def test_what_of_the_results_can_be_written_is_there(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, log: Path, tmp_path: Path
) -> None:
    def fail(*_: object) -> None:
        raise MemoryError("Unable to allocate 80 GiB")

    monkeypatch.setattr("slammot_graph.run_folder.writer.write_map", fail)
    code, out, err = run(capsys, "run", log, "--output", tmp_path / "out", "--rerun", "off")
    assert code == console.EXIT_USER_ERROR
    assert "not enough memory (Unable to allocate 80 GiB)" in err.splitlines()[-1]
    assert "path length" in out  # the table, nevertheless
    folder = read_run_folder(tmp_path / "out")
    assert len(folder.stamps) == N_SCANS
    assert folder.points is not None
    assert (tmp_path / "out" / "overview.png").exists()


@pytest.mark.skipif(sys.platform != "linux", reason="limits the size of files as Linux does")
@pytest.mark.parametrize("most_bytes", [1000, 100_000])
def test_files_that_cannot_grow(log: Path, tmp_path: Path, most_bytes: int) -> None:
    """The whole command, where no file gets longer than that; the recording's own thread is in it too."""
    code = (
        "import resource, signal, sys; from slammot_graph.cli import main;"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({most_bytes}, {most_bytes}));"
        "sys.exit(main(sys.argv[1:]))"
    )
    done = subprocess.run(
        [sys.executable, "-B", "-c", code, "run", str(log), "--output", str(tmp_path / "out")],
        cwd=tmp_path,
        env={
            **os.environ,
            "PYTHONPATH": str(Path(running.__file__).parents[2]),
            "MPLCONFIGDIR": str(tmp_path),
        },
        capture_output=True,
        text=True,
        check=False,
        timeout=120.0,
    )
    assert "Traceback" not in done.stderr
    assert done.returncode == console.EXIT_USER_ERROR
    assert done.stderr.splitlines()[-1].startswith("slammot-graph: ")
    if most_bytes > 10_000:
        assert np.isfinite(read_run_folder(tmp_path / "out").T_map_base).all()
        assert not (tmp_path / "out" / ".run.lock").exists()
