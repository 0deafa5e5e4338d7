"""`run --map`: a run that starts from the map of another one."""

from pathlib import Path

import numpy as np
import pytest

from slammot_graph import SavedMap
from slammot_graph.run_folder.tum import read_trajectory
from tests.cli.test_cli import run
from tests.localization.saved_maps import ring_map, true_in_map
from tests.loop_closure.ring import ring_log


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "first").mkdir()
    (tmp_path / "first" / "map.slam").write_bytes(ring_map().to_bytes())
    ring_log(2).write(tmp_path / "second.npz")
    return tmp_path


def words(folder: Path) -> list[object]:
    """A run of the second log that starts from the first map."""
    return [
        "run",
        folder / "second.npz",
        "--output",
        folder / "out",
        "--rerun",
        "off",
        "--map",
        folder / "first",
    ]


@pytest.mark.parametrize("localize", [True, False])
def test_run_starts_from_a_map(capsys: pytest.CaptureFixture[str], folder: Path, localize: bool) -> None:
    options = ["--localize"] if localize else []
    code, _, err = run(capsys, *words(folder), *options)
    assert code == 0, err
    _, poses = read_trajectory(folder / "out" / "trajectory.tum")
    assert np.hypot(*(poses - true_in_map(0))[:, :2].T).max() < 0.05
    assert (folder / "out" / "map.slam").exists() is not localize
    if not localize:
        assert [one.log for one in SavedMap.load(folder / "out").runs] == ["", "second.npz"]
    assert "was not found" not in err


def test_a_robot_that_is_not_found_is_told(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    code, _, err = run(capsys, *words(folder), "--max-scans", "10", "--localize")
    assert code == 0
    assert "warning: the robot was not found in" in err
    assert "give --initial-pose" in " ".join(err.split())


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--localize"], "need --map DIR"),
        (["--initial-pose", "0", "0", "0"], "need --map DIR"),
        (["--map", "nowhere"], "cannot be read"),
        (["--map", "{first}", "--initial-pose", "0", "nan", "0"], "three finite numbers"),
        (["--map", "{first}", "--method", "icp"], "choose the method graph"),
    ],
)
def test_bad_options_are_told_in_one_line(
    capsys: pytest.CaptureFixture[str], folder: Path, options: list[str], text: str
) -> None:
    given = [option.replace("{first}", str(folder / "first")) for option in options]
    code, _, err = run(
        capsys, "run", folder / "second.npz", "--output", folder / "out", "--rerun", "off", *given
    )
    assert code == 2
    assert text in err
    assert len(err.strip().splitlines()) == 1
    assert not (folder / "out").exists()


def test_a_damaged_map_is_told_in_one_line(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    path = folder / "first" / "map.slam"
    path.write_bytes(path.read_bytes()[:-100])
    code, _, err = run(
        capsys, "run", folder / "second.npz", "--output", folder / "out", "--rerun", "off", "--map", path
    )
    assert code == 2
    assert "damaged, its checksum is another one" in err
    assert len(err.strip().splitlines()) == 1
