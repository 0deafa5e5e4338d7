import json
import os
import signal
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from slammot_graph import Run, cli, results, se2
from slammot_graph.cli import running
from slammot_graph.evaluation import read_trajectory
from slammot_graph.logs import write_npz_log
from slammot_graph.result_types import StepResult

N_SCANS = 12
RUN_FILES = set(results.RUN_FILES) - {"run.rrd"}


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


def test_run_writes_a_run_folder(capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path) -> None:
    output = tmp_path / "deep" / "out"
    code, out, err = run(capsys, "run", log, "--output", output, "--rerun", "off", "--method", "odometry")
    assert code == 0
    assert {path.name for path in output.iterdir()} == RUN_FILES
    stamps, T_map_base = read_trajectory(output / "trajectory.tum")
    np.testing.assert_allclose(stamps, 100.0 + 0.2 * np.arange(N_SCANS), atol=1e-6)
    np.testing.assert_allclose(T_map_base[-1], [0.1 * (N_SCANS - 1), 0.0, 0.0], atol=1e-6)
    summary = json.loads((output / "summary.json").read_text())
    assert (summary["method"], summary["n_scans"]) == ("odometry", N_SCANS)
    assert summary["log"] == str(log)
    for word in ("scans", "skipped", "nodes", "loop closures", "median", "p95", str(output / "map.pgm")):
        assert word in out
    assert "box [1].npz" in out  # brackets in a name are no markup
    lines = err.splitlines()
    assert lines[0] == f"odometry on box [1].npz: {N_SCANS} scans"
    assert lines[-1].startswith(f"odometry on box [1].npz: {N_SCANS} scans in ")


def test_graph_runs_and_is_recorded(capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path) -> None:
    code, out, _ = run(capsys, "run", log, "--output", tmp_path / "out")
    assert code == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == {*RUN_FILES, "run.rrd"}
    assert "run.rrd" in out
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
        (["run", "LOG", "--output", "out", "--scan-topic", "/scan"], ["--scan-topic"]),
        (["run", "LOG", "--output", "bad.toml"], ["bad.toml"]),
        (["run", "LOG", "--output", "bad.toml/out"], ["bad.toml"]),
        (["config", "--method", "grph"], ["grph"]),
        (["evaluate", "out", "--relations", "none"], ["none", "cannot be read"]),
        (["evaluate", "out", "--relations", "some.relations"], ["trajectory.tum", "cannot be read"]),
        (["evaluate", "out", "--relations", "bad.toml"], ["bad.toml, line 1"]),
        (["evaluate", "out", "--relations", "some.relations", "--max-duration", "0"], ["--max-duration"]),
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
        ([], "subcommand"),
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
    assert [cell.strip() for cell in rows["icp"].split("│")[3:6]] == ["-", "0.000", "0.000"]
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
    assert {path.name for path in (tmp_path / "out").iterdir()} == {*RUN_FILES, "run.rrd"}
    assert len(read_trajectory(tmp_path / "out" / "trajectory.tum")[0]) == 6


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
        env={**os.environ, "PYTHONPATH": str(Path(se2.__file__).parents[1])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr.startswith("slammot-graph: none.relations: cannot be read")
    assert done.stderr.count("\n") == 1
