"""The command line from its arguments to its exit code.

Over 400 lines because each command's options and complaints are tried one by one.
"""

import json
import os
import signal
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slammot_graph import Run, __version__, cli
from slammot_graph import run as run_module
from slammot_graph.cli import console, running
from slammot_graph.cli.reading import open_log_of_run
from slammot_graph.core import se2
from slammot_graph.core.errors import SlammotError
from slammot_graph.core.results import StepResult
from slammot_graph.evaluation import absolute_error
from slammot_graph.logs import write_npz_log
from slammot_graph.pipeline import Pipeline
from slammot_graph.run_folder import directory
from slammot_graph.run_folder.reader import read_run_folder
from slammot_graph.run_folder.tum import read_trajectory
from slammot_graph.simulation import SCENARIOS
from tests.walkers import write_walkers

N_SCANS = 12
RUN_FILES = set(directory.RUN_FILES) - {"run.rrd"}


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "box [1].npz"
    write_box_log(path)
    return path


def write_box_log(path: Path) -> None:
    """A robot that drives straight on in a box of 8 m x 6 m, with truth; one beam is said to hit a person."""
    angles = np.radians(np.arange(181) - 90.0)
    poses = np.column_stack([0.1 * np.arange(N_SCANS), np.zeros((N_SCANS, 2))])
    cos, sin = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        to_x = np.where(cos > 1e-9, (4.0 - poses[:, :1]) / cos, np.inf)
        to_y = 3.0 / np.abs(sin)
    write_npz_log(
        path,
        stamps=100.0 + 0.2 * np.arange(N_SCANS),
        ranges=np.minimum(to_x, to_y),
        angle_min=-np.pi / 2,
        angle_increment=np.radians(1.0),
        range_min=0.1,
        range_max=30.0,
        odometry=poses,
        poses=poses,
        is_moving=np.tile(np.arange(181) == 90, (N_SCANS, 1)),
    )


def run(capsys: pytest.CaptureFixture[str], *argv: object) -> tuple[int, str, str]:
    code = cli.main([str(arg) for arg in argv])
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err
    return code, captured.out, captured.err


def assert_one_line(err: str, *parts: str) -> None:
    assert err.startswith("slammot-graph: ")
    assert err.endswith("\n")
    assert err.count("\n") == 1
    for part in parts:
        assert part in err


def table_rows(out: str) -> dict[str, str]:
    """Cells of a table of two columns, by the first; of a cell of several lines the first one."""
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in out.splitlines() if "│" in line]
    return {row[0]: row[1] for row in rows if row[0]}


def test_run_writes_a_run_folder(capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path) -> None:
    output = tmp_path / "deep" / "out"
    code, out, err = run(capsys, "run", log, "--output", output, "--rerun", "off", "--method", "odometry")
    assert code == 0
    assert {path.name for path in output.iterdir()} == RUN_FILES - {"graph.g2o", "map.slam"}
    stamps, T_map_base = read_trajectory(output / "trajectory.tum")
    np.testing.assert_allclose(stamps, 100.0 + 0.2 * np.arange(N_SCANS), atol=1e-6)
    np.testing.assert_allclose(T_map_base[-1], [0.1 * (N_SCANS - 1), 0.0, 0.0], atol=1e-6)
    summary = json.loads((output / "summary.json").read_text())
    assert (summary["method"], summary["n_scans"]) == ("odometry", N_SCANS)
    assert summary["log"] == str(log)
    assert summary["source"] == {"laser_pose": [0.0, 0.0, 0.0], "laser_pose_from": "the key laser_pose"}
    assert summary["warnings"] == []
    rows = table_rows(out)
    assert rows["scans"] == str(N_SCANS)
    assert rows["laser pose"] == "0 0 0 (x y yaw [m, m, rad]; the key laser_pose)"
    assert (rows["duration"], rows["path length"], rows["tracks"]) == ("2.2 s", "1.1 m", "0")
    assert rows["files"] == str(output)
    names = ", ".join(
        name for name in directory.RUN_FILES if name not in ("graph.g2o", "map.slam", "run.rrd")
    )
    assert names in out
    assert {"skipped", "nodes", "loop closures", "ms per scan"} <= rows.keys()
    assert "box [1].npz" in out  # brackets in a name are no markup
    lines = err.splitlines()
    assert lines[0] == f"odometry on box [1].npz: {N_SCANS} scans"
    assert lines[-1].startswith(f"odometry on box [1].npz: {N_SCANS} scans in ")


def test_graph_runs_and_is_recorded(capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path) -> None:
    code, out, _ = run(capsys, "run", log, "--output", tmp_path / "out")
    assert code == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == {*RUN_FILES, "run.rrd"}
    assert "run.rrd" in out
    hint = "about 3 is right; less: the odometry is better than its settings say, more: worse;"
    assert f"{hint} `slammot-graph calibrate` estimates them" in table_rows(out)["mean NIS"]
    T_map_base = read_trajectory(tmp_path / "out" / "trajectory.tum")[1]
    np.testing.assert_allclose(T_map_base[-1], [0.1 * (N_SCANS - 1), 0.0, 0.0], atol=0.05)


def test_settings_come_from_the_file(capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path) -> None:
    code, out, _ = run(capsys, "config", "--method", "docpfo")
    assert code == 0
    printed = tomllib.loads(out)
    assert printed["max_range_m"] == 40.0
    settings = tmp_path / "my.toml"
    settings.write_text(out.replace("max_range_m = 40.0", "max_range_m = 7.5"))
    arguments = ("run", log, "--method", "docpfo", "--rerun", "off", "--config", settings, "--output")
    assert run(capsys, *arguments, tmp_path / "a")[0] == 0
    assert run(capsys, *arguments, tmp_path / "b", "--max-range", "2")[0] == 0
    for name, expected in (("a", 7.5), ("b", 2.0)):
        summary = json.loads((tmp_path / name / "summary.json").read_text())
        assert summary["config"]["max_range_m"] == expected


def test_the_first_scans_alone(capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path) -> None:
    words = ("run", log, "--rerun", "off", "--method", "odometry", "--output")
    code, out, err = run(capsys, *words, tmp_path / "five", "--max-scans", 5)
    assert code == 0
    assert table_rows(out)["scans"] == f"5 (the first 5 scans of {N_SCANS})"
    assert err.splitlines()[0] == "odometry on box [1].npz: 5 scans"
    assert len(read_trajectory(tmp_path / "five" / "trajectory.tum")[0]) == 5
    summary = json.loads((tmp_path / "five" / "summary.json").read_text())
    assert (summary["is_complete"], summary["n_scans"], summary["n_scans_of_log"]) == (True, 5, N_SCANS)
    code, out, _ = run(capsys, *words, tmp_path / "all", "--max-scans", 500)
    assert (code, table_rows(out)["scans"]) == (0, str(N_SCANS))


def test_the_laser_may_be_placed_by_hand(
    capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path
) -> None:
    words = ("run", log, "--rerun", "off", "--method", "icp", "--output")
    laser_pose = (0.25, -0.123456789012, 3.1400000001)
    code, out, _ = run(capsys, *words, tmp_path / "out", "--laser-pose", *laser_pose)
    assert code == 0
    assert table_rows(out)["laser pose"] == "0.25 -0.123457 3.14 (x y yaw [m, m, rad]; given)"
    folder = read_run_folder(tmp_path / "out")
    assert folder.summary["source"] == {"laser_pose": list(laser_pose), "laser_pose_from": "given"}
    scan = next(iter(open_log_of_run(folder, log)))  # as `animate` and `compare` do
    assert scan.laser.T_base_laser == laser_pose  # every digit
    source = {"laser_pose": "0.25 -0.5 3.14", "laser_pose_from": "given"}  # as version 0.1 wrote it
    older = replace(folder, summary={**folder.summary, "source": source})
    assert next(iter(open_log_of_run(older, log))).laser.T_base_laser == (0.25, -0.5, 3.14)
    code, out, err = run(capsys, *words, tmp_path / "nan", "--laser-pose", "nan", 0, 0)
    assert (code, out) == (2, "")
    assert_one_line(err, "laser pose", "nan 0 0")


def test_compiling_is_announced_once(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, log: Path, tmp_path: Path
) -> None:
    monkeypatch.setattr(run_module, "has_compiled_kernels", lambda: False)
    running._announce_compilation.cache_clear()
    words = ("run", log, "--rerun", "off", "--method", "odometry", "--output")
    errs = [run(capsys, *words, tmp_path / name)[2] for name in ("a", "b")]
    assert [err.count("compiling the kernels, once: the first scans take") for err in errs] == [1, 0]


def test_commands_are_named_as_they_were_started(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    for started, named in (
        (".venv/bin/slammot-graph", ".venv/bin/slammot-graph"),
        (str(tmp_path / ".venv" / "bin" / "slammot-graph"), ".venv/bin/slammot-graph"),
        ("slammot-graph", "./slammot-graph"),
        ("/opt/their env/slammot-graph", "'/opt/their env/slammot-graph'"),
        ("/opt/slammot_graph/__main__.py", "venv/python -m slammot_graph"),
        ("/opt/pytest/__main__.py", "slammot-graph"),
    ):
        monkeypatch.setattr("sys.argv", [started])
        monkeypatch.setattr("sys.executable", str(tmp_path / "venv" / "python"))
        assert console.command("view", Path("runs/a b")) == f"{named} view 'runs/a b'"
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "slammot-graph").touch(mode=0o755)
    monkeypatch.setattr("sys.argv", [".venv/bin/slammot-graph"])
    assert console.command("view", "x") == "slammot-graph view x"


def test_a_run_is_only_replaced_on_demand(
    capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path
) -> None:
    arguments = ("run", log, "--output", tmp_path / "out", "--rerun", "off", "--method", "odometry")
    assert run(capsys, *arguments)[0] == 0
    code, out, err = run(capsys, *arguments)
    assert (code, out) == (2, "")
    assert_one_line(err, str(tmp_path / "out"), "--overwrite")
    assert run(capsys, *arguments, "--overwrite")[0] == 0


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["run", "none.clf", "--output", "out"], ["none.clf", "no such file"]),
        (["run", "LOG", "--output", "out", "--method", "grph"], ["grph", "kiss-icp-odometry"]),
        (["run", "LOG", "--output", "out", "--config", "none.toml"], ["none.toml", "cannot be read"]),
        (["run", "LOG", "--output", "out", "--config", "bad.toml"], ["bad.toml", "max_rang", "max_range_m"]),
        (["run", "LOG", "--output", "out", "--max-range", "-1"], ["max_range_m", "-1"]),
        (["run", "LOG", "--output", "out", "--max-scans", "0"], ["--max-scans", "0"]),
        (["run", "LOG", "--output", "out", "--scan-topic", "/scan"], ["--scan-topic"]),
        (["run", "LOG", "--output", "bad.toml"], ["bad.toml"]),
        (["run", "LOG", "--output", "bad.toml/out"], ["bad.toml"]),
        (["config", "--method", "grph"], ["grph"]),
        (["evaluate", "out", "--relations", "none"], ["none", "cannot be read"]),
        (["evaluate", "out", "--relations", "some.relations"], ["trajectory.tum", "cannot be read"]),
        (["evaluate", "out", "--relations", "bad.toml"], ["bad.toml, line 1"]),
        (["evaluate", "out", "--relations", "some.relations", "--max-duration", "0"], ["--max-duration"]),
        (["evaluate", "out"], ["--relations FILE or --truth FILE.tum"]),
        (["evaluate", "out", "--mot", "mot"], ["--mot", "--truth LOG.npz"]),
        (["evaluate", "out", "--truth", "none.tum"], ["none.tum", "cannot be read"]),
        (["evaluate", "out", "--truth", "bad.toml"], ["bad.toml, line 1"]),
        (["evaluate", "out", "--truth", "none.npz"], ["none.npz", "no such file"]),
        (["evaluate", "out", "--truth", "some.relations"], ["trajectory.tum", "cannot be read"]),
    ],
)
def test_a_mistake_is_one_line(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    log: Path,
    tmp_path: Path,
    arguments: list[str],
    parts: list[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bad.toml").write_text("max_rang = 3\n")
    Path("some.relations").write_text("1 2 0 0 0 0 0 0\n")
    code, out, err = run(capsys, *(str(log) if word == "LOG" else word for word in arguments))
    assert (code, out) == (2, "")
    assert_one_line(err, *parts)
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["rn"], "rn"),
        (["run"], "--output"),
        (["run", "x", "--output", "y", "--rerun", "on"], "'file'"),
        (["run", "x", "--output", "y", "--max-range", "far"], "'far'"),
        (["run", "x", "--output", "y", "--colour", "red"], "--colour"),
    ],
)
def test_wrong_arguments(capsys: pytest.CaptureFixture[str], arguments: list[str], text: str) -> None:
    code, out, err = run(capsys, *arguments)
    assert (code, out) == (2, "")
    assert text in err


def test_help(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "--help")
    assert code == 0
    for command in ("run", "view", "animate", "compare", "evaluate", "methods", "config", "simulate", "demo"):
        assert command in out


def test_without_a_command_the_help_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys)
    assert (code, err) == (2, "")
    assert "usage: slammot-graph" in out


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, "--version") == (0, f"slammot-graph {__version__}\n", "")


def test_help_names_the_scenarios(capsys: pytest.CaptureFixture[str]) -> None:
    out = " ".join(run(capsys, "simulate", "--help")[1].replace("│", "").split())
    assert f"One of {', '.join(SCENARIOS)}." in out


def test_methods_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "methods")
    assert code == 0
    for name in ("odometry", "icp", "docpfo", "graph-fixed", "kiss-icp-odometry"):
        assert name in out


def test_relations_are_evaluated(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "trajectory.tum").write_text("0.0 0 0 0 0 0 0 1\n10.0 1.3 0 0 0 0 0 1\n100.0 2 0 0 0 0 0 1\n")
    relations = tmp_path / "my.relations"
    relations.write_text("0 10 1 0 0 0 0 0\n10 100 0.8 0 0 0 0 0.1\n10 55 1 0 0 0 0 0\n")
    code, out, _ = run(capsys, "evaluate", tmp_path, "--relations", relations)
    assert code == 0
    everything, short = (line for line in out.splitlines() if "+-" in line)
    assert [cell.strip() for cell in everything.split("│")[1:-1]] == [
        *("all", "2", "1", "0.2000 +- 0.1000", "0.2000", "2.8648 +- 2.8648", "2.865")
    ]
    assert [cell.strip() for cell in short.split("│")[1:5]] == ["within 60 s", "1", "1", "0.3000 +- 0.0000"]
    relations.write_text("1 2 0 0 0 0 0 0\n")
    code, _, err = run(capsys, "evaluate", tmp_path, "--relations", relations)
    assert code == 2
    assert_one_line(err, "none of its 1 relations", "trajectory.tum")


def test_a_true_trajectory_is_evaluated(
    capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path
) -> None:
    """The run is the truth, turned by a right angle and moved, with one pose 0.2 m off and stamps that run backward."""
    poses = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [2.0, 1.0], [2.0, 2.0], [3.0, 2.0]])
    stamps = 100.0 + np.array([0.0, 0.2, 0.4, 0.3, 0.6, 9.0])
    turned = np.column_stack([5.0 - poses[:, 1], poses[:, 0]])
    quaternion = f"0 0 0 {np.sin(np.pi / 4)} {np.cos(np.pi / 4)}"
    lines = [f"{t} {x} {y} {quaternion}\n" for t, (x, y) in zip(stamps, turned, strict=True)]
    (tmp_path / "trajectory.tum").write_text("".join(lines))
    truth = tmp_path / "true.tum"
    poses[2, 0] += 0.2
    true_lines = [f"{t + 0.004} {x} {y} 0 0 0 0 1\n" for t, (x, y) in zip(stamps, poses, strict=True)]
    truth.write_text("# a comment\n" + "".join(sorted(true_lines)[:-1]))
    code, out, err = run(capsys, "evaluate", tmp_path, "--truth", truth)
    assert (code, err) == (0, "")
    rows = {
        cells[1].strip(): [x.strip() for x in cells[2:-1]]
        for cells in (line.split("│") for line in out.splitlines())
        if len(cells) > 6
    }
    assert list(rows) == ["position [m]", "heading [deg]"]
    assert rows["position [m]"][:2] == ["5", "1"]
    expected = absolute_error(
        np.column_stack([turned, np.full(6, np.pi / 2)])[:5], np.column_stack([poses, np.zeros(6)])[:5]
    )
    assert float(rows["position [m]"][2]) == pytest.approx(expected.translation_m.rmse, abs=1e-4)
    assert 0.05 < expected.translation_m.rmse < 0.1
    truth.write_text("900 0 0 0 0 0 0 1\n")
    code, _, err = run(capsys, "evaluate", tmp_path, "--truth", truth)
    assert code == 2
    assert_one_line(err, "true.tum: none of its 1 poses lies within 0.01 s", "trajectory.tum", "clock")
    truth.write_text("")
    assert_one_line(run(capsys, "evaluate", tmp_path, "--truth", truth)[2], "none of its 0 poses")


def test_a_simulated_log_is_a_true_trajectory(
    capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path
) -> None:
    run(capsys, "run", log, "--output", tmp_path / "out", "--rerun", "off", "--method", "odometry")
    code, out, _ = run(capsys, "evaluate", tmp_path / "out", "--truth", log)
    assert code == 0
    assert table_rows(out)["position [m]"] == str(N_SCANS)


def test_points_and_tracks_of_a_simulated_log_are_evaluated(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    walkers = write_walkers(tmp_path / "walkers.npz", 80)
    run(capsys, "run", walkers, "--output", tmp_path / "out", "--rerun", "off")
    mot = tmp_path / "mot"
    code, out, err = run(capsys, "evaluate", tmp_path / "out", "--truth", walkers, "--mot", mot)
    assert (code, err) == (0, "")
    assert sorted(str(path.relative_to(mot)) for path in mot.rglob("*.txt")) == [
        f"{labels}/{name}.txt" for labels in ("final", "online") for name in ("gt", "tracks")
    ]
    assert [line for line in out.splitlines() if "Moving points of" in line or "Tracks of" in line]
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in out.splitlines() if "final" in line]
    points, tracks = rows
    assert float(points[1]) > 0.9
    assert float(tracks[1]) > 0.8
    assert float(tracks[5]) < 0.1
    other = tmp_path / "other.npz"
    arrays = dict(np.load(walkers))
    np.savez(other, **{**arrays, "stamps": arrays["stamps"] + np.arange(80) % 2 * 0.005})
    code, out, err = run(capsys, "evaluate", tmp_path / "out", "--truth", other)
    assert code == 0
    assert "other.npz has other scans than the run: its points and tracks are not judged" in err
    assert "Tracks of" not in out


def test_demo_compares_the_methods(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def write(scenario: str, output: Path, **_: object) -> None:
        assert scenario == "two-walkers"
        output.parent.mkdir(exist_ok=True)
        write_box_log(output)

    monkeypatch.setattr(running, "write_simulation", write)
    for _ in range(2):  # the second time over the first
        code, out, _ = run(capsys, "demo", "--output", tmp_path / "demo")
        assert code == 0
    rows = {line.split("│")[1].strip(): line for line in out.splitlines() if line.count("│") == 7}
    assert list(rows) == list(running.DEMO_METHODS)
    assert list(rows) == ["odometry", "icp", "docpfo", "graph"]
    assert [cell.strip() for cell in rows["icp"].split("│")[3:6]] == ["-", "0.000", "0.000"]
    assert "IoU (final labels)" in out
    assert "one log (seed 0); medians over 20 seeds stand in README.md" in out
    assert f"slammot-graph view {tmp_path / 'demo' / 'graph'})" in out
    for name in ("run.rrd", "overview.png"):
        assert str(tmp_path / "demo" / "graph" / name) in out
        assert (tmp_path / "demo" / "graph" / name).exists()


def break_at(n_scans: int, monkeypatch: pytest.MonkeyPatch, action: object) -> None:
    """Let something happen in a run after so many scans."""
    iterate = Run.__iter__

    def broken(self: Run) -> Iterator[StepResult]:
        for n, step in enumerate(iterate(self), start=1):
            yield step
            if n == n_scans:
                assert callable(action)
                action()

    monkeypatch.setattr(Run, "__iter__", broken)


def test_ctrl_c_writes_what_was_computed(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, log: Path, tmp_path: Path
) -> None:
    break_at(5, monkeypatch, lambda: os.kill(os.getpid(), signal.SIGINT))
    handler = signal.getsignal(signal.SIGINT)
    code, _, err = run(capsys, "run", log, "--output", tmp_path / "out", "--method", "odometry")
    assert code == 130
    assert signal.getsignal(signal.SIGINT) is handler
    assert f"interrupted after 6 scans; what was computed is in {tmp_path / 'out'}" in err
    to_go_on = {"run.checkpoint", "run.checkpoint.scans"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == {*RUN_FILES, "run.rrd", *to_go_on} - {
        "graph.g2o",
        "map.slam",
    }
    assert len(read_trajectory(tmp_path / "out" / "trajectory.tum")[0]) == 6
    monkeypatch.undo()
    code, _, err = run(
        capsys, "run", log, "--output", tmp_path / "out", "--method", "odometry", "--rerun", "off", "--resume"
    )
    assert code == 0
    assert "going on after 6 scans" in err
    assert len(read_trajectory(tmp_path / "out" / "trajectory.tum")[0]) == N_SCANS


def test_a_failure_on_the_way_writes_what_was_computed(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, log: Path, tmp_path: Path
) -> None:
    def fail() -> None:
        raise OSError(5, "Input/output error", "some.bag")

    break_at(3, monkeypatch, fail)
    code, _, err = run(capsys, "run", log, "--output", tmp_path / "out", "--rerun", "off")
    assert code == 2
    assert err.splitlines()[-1] == "slammot-graph: some.bag: Input/output error"
    assert "stopped after 3 scans" in err
    assert len(read_trajectory(tmp_path / "out" / "trajectory.tum")[0]) == 3


def test_the_module_is_the_command(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "slammot_graph", "evaluate", "x", "--relations", "none.relations"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path(se2.__file__).parents[2])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr.startswith("slammot-graph: none.relations: cannot be read")
    assert done.stderr.count("\n") == 1


def test_progress_over_an_unknown_number_of_scans(capsys: pytest.CaptureFixture[str]) -> None:
    with console.progress("live", None, "scans") as show:
        show(3)
    told = capsys.readouterr().err.splitlines()
    assert told[0] == "live: scans"
    assert told[1].startswith("live: 3 scans in ")


def test_a_run_whose_end_fails_is_written_and_says_why(
    capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise SlammotError("the disk is full")

    monkeypatch.setattr(Pipeline, "final_labels", fail)
    code, _, err = run(capsys, "run", log, "--output", tmp_path / "out", "--rerun", "file")
    assert code == console.EXIT_USER_ERROR
    assert "warning: could not be computed: final labels: the disk is full" in err
    assert f"done with all {N_SCANS} scans; what was computed is in" in err
    assert len(read_run_folder(tmp_path / "out").stamps) == N_SCANS
    assert {path.name for path in (tmp_path / "out").iterdir()} == {*RUN_FILES, "run.rrd"}
