import json
from pathlib import Path

import numpy as np
import pytest

from slammot_graph import cli
from slammot_graph.logs import write_npz_log
from tests.rooms import LASER, drive


def write(path: Path, *, scale: float = 1.0, n: int = 30) -> Path:
    scans = drive(n).scans
    write_npz_log(
        path,
        stamps=np.array([scan.stamp for scan in scans]),
        ranges=scale * np.array([scan.ranges for scan in scans]),
        angle_min=LASER.angle_min,
        angle_increment=LASER.angle_increment,
        range_min=scale * LASER.range_min,
        range_max=scale * LASER.range_max,
        odometry=np.array([scan.T_odom_base for scan in scans]),
        laser_pose=LASER.T_base_laser,
    )
    return path


def words(text: str) -> str:
    return " ".join(text.replace("│", " ").split())


def test_a_good_log(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert cli.main(["check", str(write(tmp_path / "log.npz"))]) == 0
    out = words(capsys.readouterr().out)
    assert "nothing wrong was found" in out
    assert "181 over 270 degrees" in out
    assert "30 usable, the first 30 of them matched" in out
    assert list(tmp_path.iterdir()) == [tmp_path / "log.npz"]


def test_an_error_is_told_by_the_exit_code_too(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert cli.main(["check", str(write(tmp_path / "log.npz", scale=1000.0))]) == 1
    assert "error: ranges look like millimetres" in words(capsys.readouterr().out)


def test_json(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert cli.main(["check", str(write(tmp_path / "log.npz", scale=1000.0)), "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert told["n_scans"] == 30
    assert told["odometry"]["clock_offset_s"] == {"value": 0.0, "std": None}
    (finding,) = told["verdict"]
    assert finding["kind"] == "ranges in millimetres"
    assert finding["remedy"].startswith("divide ranges")


def test_a_log_that_is_none(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert cli.main(["check", str(tmp_path / "none.npz")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_run_tells_it_before_and_after(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    log, folder = write(tmp_path / "log.npz", scale=1000.0), tmp_path / "run"
    assert cli.main(["run", str(log), "--output", str(folder), "--rerun", "off"]) == 0
    told = capsys.readouterr()
    assert told.err.count("error: ") == 1
    assert "ranges look like millimetres" in told.err.splitlines()[0]
    assert "verdict error: ranges look like millimetres" in words(told.out)
    summary = json.loads((folder / "summary.json").read_text())
    assert [finding["kind"] for finding in summary["verdict"]] == ["ranges in millimetres"]
    assert summary["health"]["counts"]["degenerate"] == 29
    assert summary["health"]["intervals"] == [{"state": "degenerate", "first": 1, "last": 29}]
    assert summary["odometry"]["source"] == "odometry"
    assert summary["odometry"]["heading_scale"] == {"value": 1.0, "std": None}
