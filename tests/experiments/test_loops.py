"""The experiments on loop closure, in quick mode and on made logs."""

from pathlib import Path

import numpy as np
import pytest

from experiments import false_closures, freiburg, large_building, lost_robot
from experiments.freiburg import LoopOptions, command_line
from slammot_graph.core import se2
from slammot_graph.core.results import GraphEdge
from slammot_graph.simulation import SimulatedLog, simulate


@pytest.fixture(scope="module")
def lab() -> SimulatedLog:
    return simulate("lab", seed=0, n_laps=2)


@pytest.fixture(scope="module")
def data(lab: SimulatedLog, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recorded log, true relations beside it, and a log without."""
    folder = tmp_path_factory.mktemp("data")
    (folder / "deeper").mkdir()
    lines = []
    for stamp, ranges, T in zip(lab.stamps, lab.ranges, lab.T_odom_base, strict=True):
        pose = " ".join(f"{value:.6f}" for value in T)
        values = " ".join(f"{value:.3f}" for value in ranges)
        lines.append(f"FLASER {len(ranges)} {values} {pose} {pose} {stamp + 1e5:.6f} host {stamp:.6f}")
    (folder / "deeper" / "mylab.clf").write_text("\n".join(lines) + "\n")
    (folder / "deeper" / "other.clf").write_text("\n".join(lines[:100]) + "\n")
    first = np.arange(0, lab.n_scans - 50, 25)
    relations = se2.between(lab.T_world_base[first], lab.T_world_base[first + 50])
    rows = [
        f"{lab.stamps[i] + 1e5:.6f} {lab.stamps[i + 50] + 1e5:.6f} {x:.6f} {y:.6f} 0 0 0 {theta:.6f}"
        for i, (x, y, theta) in zip(first, relations, strict=True)
    ]
    (folder / "deeper" / "mylab.relations").write_text("\n".join(rows) + "\n")
    return folder


def rows_of(path: Path) -> dict[str, list[str]]:
    """Rows of the Markdown tables in a file by their first cell; of equal ones the first."""
    rows: dict[str, list[str]] = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.startswith("| "):
            cells = [cell.strip() for cell in line.strip("| ").split(" | ")]
            rows.setdefault(cells[0], cells[1:])
    return rows


def test_freiburg_finds_logs_with_relations(data: Path, tmp_path: Path) -> None:
    output = tmp_path / "freiburg.md"
    arguments = ["--quick", "--data", str(data), "--output", str(output)]
    assert command_line(freiburg.experiment, LoopOptions, arguments) == 0
    text = output.read_text(encoding="utf-8")
    assert "## mylab: errors" in text
    assert "other" not in text
    assert "equal bit by bit" in text
    rows = rows_of(output)
    assert set(freiburg.QUICK_METHODS) <= set(rows)
    assert float(rows["graph"][0].split(" +- ")[0]) < 0.03
    assert float(rows["odometry"][0].split(" +- ")[0]) > float(rows["graph"][0].split(" +- ")[0])


def test_without_logs_there_is_a_clear_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command_line(freiburg.experiment, LoopOptions, ["--data", str(tmp_path)]) == 2
    assert "SLAMMOT_DATA" in capsys.readouterr().err


def test_false_closures(data: Path, tmp_path: Path) -> None:
    output = tmp_path / "false.md"
    arguments = ["--quick", "--data", str(data), "--output", str(output), "--log", "mylab"]
    assert command_line(false_closures.experiment, false_closures.FalseOptions, arguments) == 0
    rows = rows_of(output)
    assert {"none", "10 random", "15 aliased, 3 m"} <= set(rows)
    assert " of 10" in rows["10 random"][7]
    assert "--log mylab" in output.read_text(encoding="utf-8")


def test_large_building(tmp_path: Path) -> None:
    output = tmp_path / "building.md"
    assert command_line(large_building.experiment, LoopOptions, ["--quick", "--output", str(output)]) == 0
    text = output.read_text(encoding="utf-8")
    assert all(f"| {method} |" in text for method in large_building.METHODS)


def test_lost_robot(data: Path, tmp_path: Path) -> None:
    output = tmp_path / "lost.md"
    arguments = ["--quick", "--data", str(data), "--output", str(output)]
    assert command_line(lost_robot.experiment, LoopOptions, arguments) == 0
    rows = rows_of(output)
    n_out, n_in = rows["mylab"][1].split(" of ")
    assert n_out == n_in == str(lost_robot.QUICK_SCANS)


def test_closure_errors_tell_wrong_from_right() -> None:
    nodes = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 2.0, 1.5]])
    T = se2.between(nodes[0], nodes[2])
    off = [np.zeros(3), np.array([0.6, 0.0, 0.0]), np.array([0.0, 0.0, 0.2])]
    closures = [
        GraphEdge(
            kind="closure", from_node=0, to_node=2, T_from_to=se2.compose(T, error), information=np.eye(3)
        )
        for error in off
    ]
    distance_m, angle_deg = freiburg.closure_errors(closures, nodes)
    assert distance_m == pytest.approx([0.0, 0.6, 0.0], abs=1e-9)
    assert angle_deg == pytest.approx([0.0, 0.0, np.degrees(0.2)], abs=1e-6)
    assert freiburg.is_wrong(distance_m, angle_deg).tolist() == [False, True, True]


def test_a_carried_robot_stands_by_its_wheels_and_is_elsewhere_by_the_truth() -> None:
    whole = simulate("hall", seed=0, n_people=0)
    kidnapped = lost_robot.kidnap(whole, 50, np.inf)
    before, after = kidnapped.first_occluded - 1, kidnapped.first_after
    log = kidnapped.log
    assert log.T_odom_base[after] == pytest.approx(log.T_odom_base[before], abs=1e-12)
    away = log.T_world_base[after] - log.T_world_base[before]
    assert lost_robot.KIDNAPPED_M <= np.hypot(away[0], away[1]) < lost_robot.KIDNAPPED_M + 0.2
    assert all(not scan.is_valid().any() for scan in list(log)[kidnapped.first_occluded : after])
    step = se2.between(log.T_odom_base[-2], log.T_odom_base[-1])
    assert step == pytest.approx(se2.between(whole.T_odom_base[-2], whole.T_odom_base[-1]), abs=1e-9)
    assert np.diff(log.stamps) == pytest.approx(0.1, abs=1e-6)


def test_odometry_jumps_once(lab: SimulatedLog) -> None:
    jump = np.array([2.0, 0.0, 0.0])
    scans = list(lost_robot.JumpedLog(lab, 3, jump))
    odometry = np.array([scan.T_odom_base for scan in scans])
    assert len(scans) == lab.n_scans
    assert odometry[:3] == pytest.approx(lab.T_odom_base[:3])
    assert odometry[3:, 0] - lab.T_odom_base[3:, 0] == pytest.approx(np.full(lab.n_scans - 3, 2.0))
