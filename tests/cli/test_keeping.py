"""`run --resume`: after an end without warning the same files come out, byte by byte."""

import filecmp
import json
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from slammot_graph.checkpoints import Checkpoints
from slammot_graph.cli import console
from slammot_graph.core.results import StepResult
from slammot_graph.core.scan import Scan
from slammot_graph.logs import write_npz_log
from slammot_graph.pipeline import Pipeline
from slammot_graph.run_folder.checkpoint import CHECKPOINT_FILE, SCANS_FILE
from slammot_graph.run_folder.directory import RUN_FILES
from slammot_graph.run_folder.reader import read_run_folder
from tests.cli.test_cli import N_SCANS, run, write_box_log

SAME = set(RUN_FILES) - {"summary.json", "run.rrd", "overview.png"}
OF_TIME = {"stages_ms", "scans_per_s", "peak_memory_mb"}


class Killed(BaseException):
    """As `kill -9`: nothing may be done about it."""


@pytest.fixture
def log(tmp_path: Path) -> Path:
    write_box_log(tmp_path / "box.npz")
    return tmp_path / "box.npz"


@pytest.fixture(autouse=True)
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    """A checkpoint after each scan with an odd number."""
    n = 0

    def after_step(self: Checkpoints) -> None:
        nonlocal n
        n += 1
        if n % 2:
            self.write()

    monkeypatch.setattr(Checkpoints, "after_step", after_step)


@pytest.fixture
def kill_at(monkeypatch: pytest.MonkeyPatch) -> Iterator[object]:
    """Let the process end at a scan: what it would still do at its end is taken from it."""

    def at(index: int) -> pytest.MonkeyPatch:
        context = pytest.MonkeyPatch()
        step = Pipeline.step

        def killed(self: Pipeline, scan: Scan) -> StepResult:
            if scan.index == index:
                raise Killed
            return step(self, scan)

        context.setattr(Pipeline, "step", killed)
        return context

    return at  # type: ignore[return-value]


def interrupted(
    capsys: pytest.CaptureFixture[str], log: Path, output: Path, kill_at: object, index: int, *words: str
) -> None:
    context = kill_at(index)  # type: ignore[operator]
    with suppress(Killed):
        run(capsys, "run", log, "--output", output, *words)
    context.undo()


def assert_same_folders(one: Path, other: Path) -> None:
    for name in SAME:
        assert filecmp.cmp(one / name, other / name, shallow=False), name
    a, b = (json.loads((folder / "summary.json").read_text()) for folder in (one, other))
    assert {k: v for k, v in a.items() if k not in OF_TIME} == {
        k: v for k, v in b.items() if k not in OF_TIME
    }


@pytest.mark.parametrize("mode", ["off", "file"])
def test_what_was_killed_goes_on(
    capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path, kill_at: object, mode: str
) -> None:
    whole, output = tmp_path / "whole", tmp_path / "out"
    assert run(capsys, "run", log, "--output", whole, "--rerun", "off")[0] == console.EXIT_OK
    interrupted(capsys, log, output, kill_at, 6, "--rerun", mode)
    partial = read_run_folder(output)
    assert 4 <= len(partial.stamps) <= 6
    assert partial.summary["is_complete"] is False
    interrupted(capsys, log, output, kill_at, 9, "--rerun", mode, "--resume")
    code, _, err = run(capsys, "run", log, "--output", output, "--rerun", mode, "--resume")
    assert code == console.EXIT_OK
    assert "going on after " in err
    assert_same_folders(whole, output)
    recordings = {path.name for path in output.glob("*.rrd")}
    assert recordings == (set() if mode == "off" else {"run.1.rrd", "run.2.rrd", "run.rrd"})
    assert not {CHECKPOINT_FILE, SCANS_FILE} & {path.name for path in output.iterdir()}
    # and a later run takes all of it away
    run(capsys, "run", log, "--output", output, "--rerun", "off", "--overwrite")
    assert not list(output.glob("*.rrd"))


def test_parts_of_a_recording_are_one(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    log: Path,
    tmp_path: Path,
    kill_at: object,
) -> None:
    output = tmp_path / "out"
    interrupted(capsys, log, output, kill_at, 6)
    assert run(capsys, "run", log, "--output", output, "--resume")[0] == console.EXIT_OK
    from rerun.chunk import RrdReader

    ids = [[one.recording_id for one in RrdReader(path).recordings()] for path in output.glob("*.rrd")]
    assert len(ids) == 2
    assert ids[0] == ids[1]
    opened: list[object] = []

    class Done:
        returncode = 0

    def look(argv: list[object], **_: object) -> Done:
        opened.extend(argv)
        return Done()

    monkeypatch.setattr("subprocess.run", look)
    assert run(capsys, "view", output)[0] == console.EXIT_OK
    assert opened[1:] == [output / "run.1.rrd", output / "run.rrd"]


def test_where_there_is_nothing_a_run_begins(
    capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path
) -> None:
    output = tmp_path / "out"
    assert run(capsys, "run", log, "--output", output, "--rerun", "off", "--resume")[0] == console.EXIT_OK
    assert len(read_run_folder(output).stamps) == N_SCANS
    before = (output / "trajectory.tum").read_bytes()
    code, _, err = run(capsys, "run", log, "--output", output, "--rerun", "off", "--resume")
    assert code == console.EXIT_USER_ERROR
    assert "holds a run that has ended" in err
    assert (output / "trajectory.tum").read_bytes() == before


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--method", "docpfo"], "is of another method"),
        (["--max-range", "5"], "is of other settings"),
        (["--overwrite"], "pass one of them"),
        (["--checkpoint-every", "-1"], "must be 0 or more seconds"),
        (["--checkpoint-every", "nan"], "must be 0 or more seconds"),
    ],
)
def test_what_cannot_go_on_is_told_and_stays(
    capsys: pytest.CaptureFixture[str],
    log: Path,
    tmp_path: Path,
    kill_at: object,
    words: list[str],
    text: str,
) -> None:
    output = tmp_path / "out"
    interrupted(capsys, log, output, kill_at, 8, "--rerun", "off")
    before = (output / CHECKPOINT_FILE).read_bytes()
    code, _, err = run(capsys, "run", log, "--output", output, "--rerun", "off", "--resume", *words)
    assert code == console.EXIT_USER_ERROR
    assert text in err.splitlines()[-1]
    assert (output / CHECKPOINT_FILE).read_bytes() == before
    assert len(read_run_folder(output).stamps) >= 6


def test_another_log_is_told_and_the_partial_run_stays(
    capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path, kill_at: object
) -> None:
    output, other = tmp_path / "out", tmp_path / "other.npz"
    interrupted(capsys, log, output, kill_at, 8, "--rerun", "off")
    write_npz_log(
        other,
        stamps=0.1 * np.arange(20.0),
        ranges=np.full((20, 30), 2.0),
        angle_min=-1.0,
        angle_increment=0.1,
        range_min=0.1,
        range_max=9.0,
        odometry=np.zeros((20, 3)),
    )
    code, _, err = run(capsys, "run", other, "--output", output, "--rerun", "off", "--resume")
    assert code == console.EXIT_USER_ERROR
    assert "are not those of the checkpoint" in err.splitlines()[-1]
    assert (output / CHECKPOINT_FILE).exists()
    assert len(read_run_folder(output).stamps) >= 6
