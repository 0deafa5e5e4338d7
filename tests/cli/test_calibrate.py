import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from slammot_graph import cli
from slammot_graph.core.config import from_plain, load_config
from slammot_graph.methods import get_method
from slammot_graph.pipeline import Pipeline, PipelineConfig
from slammot_graph.simulation import SimulatedLog, robot, simulate
from tests.cli.test_cli import assert_one_line, run, write_box_log


def odometry_noise(path: Path) -> np.ndarray:
    """Standard deviations [m, rad] of an increment of 1 m and 1 rad."""
    config = load_config(path, get_method("graph").config)
    assert isinstance(config, PipelineConfig)
    return np.sqrt(config.odometry_noise.covariance(np.array([1.0, 0.0, 1.0])).diagonal()[[0, 2]])


def mean_nis(log: SimulatedLog, settings: Path | None = None) -> float:
    """Of a run without loop closure, for speed."""
    config = get_method("graph").config
    if settings is not None:
        config = load_config(settings, config)
    assert isinstance(config, PipelineConfig)
    pipeline = Pipeline(from_plain({"localizer": {"close_loops": False}}, config))
    try:
        return float(np.nanmean([pipeline.step(scan).innovation_nis for scan in log]))
    finally:
        pipeline.close()


@pytest.mark.parametrize("noise_scale", [0.5, 1.0, 2.0])
def test_the_noise_of_a_simulated_log_is_found(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, noise_scale: float
) -> None:
    log, settings = tmp_path / "lab.npz", tmp_path / "deep" / "my.toml"
    simulate("lab", seed=3, n_people=1, noise_scale=noise_scale).write(log)
    code, out, err = run(capsys, "calibrate", log, "--output", settings)
    assert code == 0
    for word in ("std_rad_per_sqrt_m", "default", "estimated", "windows", str(settings), "1 if consistent"):
        assert word in out
    assert "warning" not in err
    # of the whole noise but for slips; systematic errors as large as they are in the mean
    of = robot.OdometryNoise()
    true_m2 = of.xy_std_per_sqrt_m**2 + of.xy_std_per_sqrt_rad**2 + of.scale_std**2
    random_rad2 = of.theta_std_per_sqrt_m**2 + of.theta_std_per_sqrt_rad**2
    true_rad2 = random_rad2 + of.turn_scale_std**2 + of.bias_std_rad_per_m**2
    ratio = odometry_noise(settings) / (noise_scale * np.sqrt([true_m2, true_rad2]))
    assert (ratio > 1.0 / 1.5).all()
    assert (ratio < 1.5).all()
    # the file is complete, and only the noise has changed
    text = settings.read_text()
    assert text.startswith("# slammot-graph run LOG --output DIR --method graph --config FILE.toml\n")
    written = tomllib.loads(text)
    shown = tomllib.loads(run(capsys, "config")[1])
    assert written.pop("odometry_noise") != shown.pop("odometry_noise")
    assert written == shown


def test_innovations_come_nearer_to_what_they_should_be(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path, settings = tmp_path / "lab.npz", tmp_path / "my.toml"
    log = simulate("lab", seed=4, n_people=1)
    log.write(path)
    assert run(capsys, "calibrate", path, "--output", settings, "--max-scans", 500)[0] == 0
    assert 1.8 * mean_nis(log) < mean_nis(log, settings) < 3.0


def test_a_run_takes_the_settings(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    log, box, settings = tmp_path / "lab.npz", tmp_path / "box.npz", tmp_path / "my.toml"
    simulate("lab", seed=3, n_people=0).write(log)
    write_box_log(box)
    assert run(capsys, "calibrate", log, "--output", settings, "--max-scans", 200)[0] == 0
    arguments = ("run", box, "--rerun", "off", "--config", settings, "--output", tmp_path / "out")
    assert run(capsys, *arguments)[0] == 0
    used = json.loads((tmp_path / "out" / "summary.json").read_text())["config"]["odometry_noise"]
    written = tomllib.loads(settings.read_text())["odometry_noise"]
    assert {name: value for name, value in used.items() if name != "type"} == pytest.approx(
        {name: value for name, value in written.items() if name != "type"}
    )


def test_a_log_with_one_kind_of_motion_keeps_the_rest(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    log = tmp_path / "lab [2].npz"
    simulate("lab", seed=3, n_people=0).write(log)
    code, out, err = run(capsys, "calibrate", log, "--max-scans", 30)
    assert code == 0
    warnings = [line for line in err.splitlines() if line.startswith("warning")]
    assert len(warnings) == 1
    assert "rad turned; kept as they are: std_m_per_sqrt_m," in warnings[0]
    assert out.count("kept") == 6
    assert list(tmp_path.iterdir()) == [log]  # no output was asked for


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (
            ["LOG", "--max-scans", "3"],
            [
                "LOG",
                "windows of scans matched on one local map: 1, needed: 30",
                "calibrate on a log in which the robot drives",
            ],
        ),
        (["LOG", "--max-scans", "0"], ["--max-scans must be at least 1, not 0"]),
        (["LOG", "--method", "icp"], ["--method icp does not match onto a local map"]),
        (["LOG", "--method", "kiss-icp"], ["--method kiss-icp does not match onto a local map"]),
        (["LOG", "--method", "grph"], ["grph"]),
        (["LOG", "--output", "LOG"], ["LOG", "is the log itself"]),
        (["LOG", "--output", "folder"], ["folder", "is no plain file"]),
        (["none.npz"], ["none.npz", "no such file"]),
    ],
)
def test_a_mistake_is_one_line(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    arguments: list[str],
    parts: list[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    write_box_log(Path("LOG.npz"))
    Path("folder").mkdir()
    named = ["LOG.npz" if argument == "LOG" else argument for argument in arguments]
    code, out, err = run(capsys, "calibrate", *named)
    assert (code, out) == (2, "")
    assert_one_line("\n".join([*err.splitlines()[-1:], ""]), *parts)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["LOG.npz", "folder"]


def test_the_command_has_its_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["calibrate", "--help"]) == 0
    assert "--max-scans" in capsys.readouterr().out
