"""The speed experiment, without a word on how fast anything is: timing is no test."""

import json
from pathlib import Path

import numpy as np
import pytest

from experiments import speed
from experiments.speed import METHODS, main, too_slow
from slammot_graph.core import se2
from slammot_graph.simulation import simulate


def test_quick_mode_writes_its_tables(tmp_path: Path) -> None:
    assert main(["--quick", "--scans", "100", "--output", str(tmp_path)]) == 0
    text = (tmp_path / "tables" / "speed.md").read_text(encoding="utf-8")
    assert "Quick mode" in text
    assert "nan" not in text.lower()
    assert [method for method in METHODS if f"| {method} |" not in text] == []
    assert "100 scans" in text
    for block in text.split("\n\n"):
        assert len({line.count("|") for line in block.splitlines() if line.startswith("|")}) <= 1


def test_the_long_drive_never_jumps_and_its_odometry_drifts_on() -> None:
    log = simulate("one-walker", seed=0)
    n_scans = 3 * log.n_scans
    scans = list(speed._endless(log, n_scans))
    assert [scan.index for scan in scans] == list(range(n_scans))
    T_odom_base = np.array([scan.T_odom_base for scan in scans])
    steps = se2.between(T_odom_base[:-1], T_odom_base[1:])
    assert np.hypot(steps[:, 0], steps[:, 1]).max() < 0.3
    again = 2 * log.n_scans - 2  # back where it started
    np.testing.assert_array_equal(scans[again].ranges, scans[0].ranges)
    assert not np.allclose(T_odom_base[again], T_odom_base[0], atol=1e-3)


def test_the_gate_fails_above_a_quarter_more() -> None:
    assert too_slow({"a": 1.24, "b": 0.5}, {"a": 1.0, "b": 0.5}) == []
    (failure,) = too_slow({"a": 1.26, "b": 0.5}, {"a": 1.0, "b": 0.5})
    assert "26% over" in failure


def test_the_gate_says_what_it_compares(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "speed.json"
    monkeypatch.setattr(speed, "measure_ratios", lambda: {"lms200": 1.0})
    assert main(["--write-baseline", "--baseline", str(path)]) == 0
    assert json.loads(path.read_text(encoding="utf-8"))["ratios"] == {"lms200": 1.0}
    assert main(["--gate", "--baseline", str(path)]) == 0
    monkeypatch.setattr(speed, "measure_ratios", lambda: {"lms200": 1.3})
    assert main(["--gate", "--baseline", str(path)]) == 1
    assert "FAILED: lms200" in capsys.readouterr().err


def test_a_gate_without_a_baseline_is_a_mistake(tmp_path: Path) -> None:
    assert main(["--gate", "--baseline", str(tmp_path / "missing.json")]) == 2
