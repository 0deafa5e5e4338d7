"""The search for kiss-icp's setting, in quick mode and with a tiny grid."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments import common, kiss_search
from experiments.common import ROOT, main
from slammot_graph.baselines.kiss_icp import KissIcpPipeline
from tests.rooms import drive, errors

DATA = Path(os.environ.get("SLAMMOT_DATA") or ROOT.parent / "shared" / "data")
needs_data = pytest.mark.skipif(
    not (DATA / "freiburg" / "intel.clf.bz2").is_file(), reason="no recorded logs in $SLAMMOT_DATA"
)


def search(tmp_path: Path, *more: str) -> str:
    """Run it in this process and give its table's file."""
    arguments = ["--jobs", "1", "--data", str(DATA), "--output", str(tmp_path), *more]
    assert main(kiss_search.experiment, arguments) == 0
    return (tmp_path / "tables" / "kiss_search.md").read_text(encoding="utf-8")


def rows_of(text: str) -> list[list[str]]:
    return [line.strip("| ").split(" | ") for line in text.splitlines() if line[:3].strip("| ").isdigit()]


def forbid(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: int) -> None:
        raise AssertionError("a finished cell was run again")

    monkeypatch.setattr(common, "local_workers", fail)


@needs_data
def test_quick_mode(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    text = search(tmp_path, "--quick")
    rows = rows_of(text)
    assert len(rows) == 3
    assert sum("**used as `kiss-icp`**" in row[0] for row in rows) == 1
    (defaults,) = (row for row in rows if "kiss-icp's defaults" in row[0])
    assert defaults[1:7] == ["1", "own", "own", "adaptive", "100", "20"]
    assert all(float(row[-1]) > 0.0 for row in rows)
    forbid(monkeypatch)
    assert search(tmp_path, "--quick") == text


@needs_data
def test_both_stages(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(kiss_search, "LOGS", ("intel",))
    monkeypatch.setattr(kiss_search, "N_SCANS", 40)
    monkeypatch.setattr(kiss_search, "VOXELS_M", (0.5, 1.0))
    monkeypatch.setattr(kiss_search, "SPACINGS_M", ((None, None),))
    monkeypatch.setattr(kiss_search, "THRESHOLDS_M", (None,))
    monkeypatch.setattr(kiss_search, "N_BEST", 1)
    monkeypatch.setattr(kiss_search, "cell", scored_by_range)
    text = search(tmp_path)
    rows = rows_of(text)
    # for each start: defaults, the one used, two of the grid; the best one (of 20 m) at five more points
    assert len(rows) == 2 * (4 + 5)
    for use_odometry, part in enumerate(text.split("## Started from")[1:]):
        assert [row[0].split()[0] for row in rows_of(part)] == [str(k) for k in range(1, 10)]
        scores = [float(row[7]) for row in rows_of(part)]
        assert scores == sorted(scores)
        assert [row[5] for row in rows_of(part)[:2]] == ["10", "10"]
        assert f"used as `{kiss_search.METHODS[bool(use_odometry)]}`" in part
    assert len((tmp_path / "results" / "kiss_search.jsonl").read_text().splitlines()) == 18
    # anew, the second stage does not throw away what the first one wrote
    assert rows_of(search(tmp_path, "--fresh")) == rows
    assert len((tmp_path / "results" / "kiss_search.jsonl").read_text().splitlines()) == 18
    forbid(monkeypatch)
    assert search(tmp_path) == text


def scored_by_range(log: str, n_scans: int, setting: dict[str, Any]) -> dict[str, Any]:
    """A cell that runs nothing."""
    assert n_scans == 40
    assert Path(log).name == "intel.clf.bz2"
    value = float(setting["max_range_m"])
    return {"near_m": value, "near_deg": 0.0, "n_near": 1, "all_m": value, "n_all": 1, "ms": 1.0}


def test_without_logs_there_is_a_clear_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--quick", "--data", str(tmp_path), "--output", str(tmp_path)]
    assert main(kiss_search.experiment, arguments) == 2
    assert "intel.clf.bz2: no such recorded log" in capsys.readouterr().err


def test_settings_without_a_score_come_last() -> None:
    made = kiss_search._Search.__new__(kiss_search._Search)
    made.logs = ("a", "b")
    first, second, third = ((False, k) for k in range(3))
    made.scores = {
        first: {"a": {"near_m": 0.1}, "b": {"near_m": float("nan")}},
        second: {"a": {"near_m": 0.5}, "b": {"near_m": 0.1}},
        third: {"a": {"near_m": 0.1}, "b": {"near_m": 0.2}},
        (True, 0): {"a": {"near_m": 0.0}, "b": {"near_m": 0.0}},
    }
    assert made.best(False) == [third, second, first]


def test_the_defaults_are_those_of_kiss_icp() -> None:
    from kiss_icp.config import KISSConfig
    from kiss_icp.kiss_icp import KissICP

    config = KISSConfig()
    config.data.deskew = False  # there are no times within a scan
    config.mapping.voxel_size = config.data.max_range / 100.0  # as its load_config does
    kiss, ours = KissICP(config), KissIcpPipeline(kiss_search.DEFAULTS)
    theirs = []
    log = drive(25)
    for scan in log:
        ours.step(scan)
        points = scan.points_base()[scan.is_valid()]
        kiss.register_frame(np.column_stack([points, np.zeros(len(points))]), np.zeros(0))
        pose = kiss.last_pose
        theirs.append([pose[0, 3], pose[1, 3], np.arctan2(pose[1, 0], pose[0, 0])])
    assert max(errors(np.array(theirs), ours.final().T_map_base)) < 1e-9
    assert np.abs(np.array(theirs)[-1]).max() > 0.5
