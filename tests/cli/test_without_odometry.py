"""Logs without odometry through the commands, in small."""

import json
from pathlib import Path

import numpy as np
import pytest

from slammot_graph.cli.reading import open_log_of_run
from slammot_graph.evaluation import absolute_error
from slammot_graph.logs import open_log, source_of, write_npz_log
from slammot_graph.methods import METHODS
from slammot_graph.run import Run
from slammot_graph.run_folder.reader import read_run_folder
from slammot_graph.run_folder.tum import read_trajectory
from tests.cli.test_cli import assert_one_line, run
from tests.rooms import ListLog, drive, odometry_of


@pytest.fixture(scope="module")
def made() -> ListLog:
    return drive(60)


@pytest.fixture(scope="module")
def log(made: ListLog, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "wheelless.npz"
    write(path, made, has_odometry=False)
    return path


def write(path: Path, made: ListLog, *, has_odometry: bool) -> None:
    laser = made.scans[0].laser
    write_npz_log(
        path,
        stamps=[scan.stamp for scan in made.scans],
        ranges=[scan.ranges for scan in made.scans],
        angle_min=laser.angle_min,
        angle_increment=laser.angle_increment,
        range_min=laser.range_min,
        range_max=laser.range_max,
        odometry=[odometry_of(scan) for scan in made.scans] if has_odometry else None,
        laser_pose=laser.T_base_laser,
        poses=truth_of(made),
    )


def truth_of(made: ListLog) -> np.ndarray:
    poses = [scan.truth.T_world_base for scan in made.scans if scan.truth is not None]
    return np.array(poses)


@pytest.mark.parametrize("method", sorted(set(METHODS) - {"odometry"}))
def test_every_method_that_matches_runs(log: Path, made: ListLog, method: str) -> None:
    result = Run(open_log(log), method).complete()
    assert result.is_complete
    assert np.isfinite(result.T_map_base).all()
    assert np.isnan(result.T_map_odom_base).all()
    assert result.T_map_odom_base.shape == result.T_map_base.shape
    error_m = absolute_error(result.T_map_base, truth_of(made)).translation_m.rmse
    # the paper's ICP drifts with the start that the previous motion gives it
    drifting = {"icp": 0.5, "docpfo": 0.5, "icp-every-scan": 0.15, "docpfo-every-scan": 0.15}
    assert error_m < drifting.get(method, 0.06 if method.startswith("kiss") else 0.03)


def test_a_run_with_recording_and_picture(
    capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path
) -> None:
    code, out, err = run(capsys, "run", log, "--output", tmp_path / "run")
    assert code == 0
    assert "the laser alone" in err
    assert "none" in out
    assert (tmp_path / "run" / "run.rrd").stat().st_size > 0
    assert (tmp_path / "run" / "overview.png").exists()
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["source"]["odometry"] == "none"


def test_odometry_off_is_as_a_log_without(
    capsys: pytest.CaptureFixture[str], log: Path, made: ListLog, tmp_path: Path
) -> None:
    write(tmp_path / "full.npz", made, has_odometry=True)
    for path, more in ((log, ()), (tmp_path / "full.npz", ("--odometry", "off"))):
        assert run(capsys, "run", path, "--output", tmp_path / path.stem, "--rerun", "off", *more)[0] == 0
    stamps, T_map_base = read_trajectory(tmp_path / "full" / "trajectory.tum")
    _, expected = read_trajectory(tmp_path / log.stem / "trajectory.tum")
    assert len(stamps) == 60
    np.testing.assert_array_equal(T_map_base, expected)
    again = open_log_of_run(read_run_folder(tmp_path / "full"), tmp_path / "full.npz")
    assert source_of(again)["odometry"] == "off"
    assert next(iter(again)).T_odom_base is None


def test_the_method_odometry_and_calibrate_need_odometry(
    capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path
) -> None:
    code, _, err = run(capsys, "run", log, "--output", tmp_path / "run", "--method", "odometry")
    assert code == 2
    assert_one_line(err, str(log), "no odometry", "graph")
    assert not (tmp_path / "run").exists()
    code, _, err = run(capsys, "calibrate", log)
    assert code == 2
    assert_one_line(err, str(log), "no odometry")


def test_people_are_injected_without_odometry(
    capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path
) -> None:
    made = tmp_path / "people.npz"
    assert run(capsys, "inject", log, "--people", 1, "--output", made)[0] == 0
    assert "odometry" not in np.load(made).files
    assert len(list(open_log(made))) == 60


def test_odometry_that_ends_half_way(made: ListLog, tmp_path: Path) -> None:
    write(tmp_path / "full.npz", made, has_odometry=True)
    arrays = dict(np.load(tmp_path / "full.npz"))
    arrays["odometry"][30:] = np.nan
    np.savez(tmp_path / "half.npz", **arrays)
    result = Run(open_log(tmp_path / "half.npz"), "graph").complete()
    assert len(result.stamps) == 60
    assert np.isfinite(result.T_map_odom_base).all(axis=1).sum() == 30
    assert absolute_error(result.T_map_base, truth_of(made)).translation_m.rmse < 0.03
