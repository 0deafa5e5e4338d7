"""Trajectories in the TUM format, of this package and of others."""

from pathlib import Path

import numpy as np
import pytest

from slammot_graph.core.errors import InputError
from slammot_graph.run_folder.tum import read_trajectory, write_trajectory


def test_trajectory_file(tmp_path: Path) -> None:
    path = tmp_path / "trajectory.tum"
    half = np.sqrt(0.5)
    path.write_text(f"# a comment\n1.5 1 2 0 0 0 {half} {half}\n\n2.5 3 4 0 0 0 -1 0\n")
    stamps, poses = read_trajectory(path)
    np.testing.assert_allclose(stamps, [1.5, 2.5])
    np.testing.assert_allclose(poses, [[1, 2, np.pi / 2], [3, 4, -np.pi]])
    path.write_text("")
    assert read_trajectory(path)[1].shape == (0, 3)


@pytest.mark.parametrize("line", ["1 2 3", "1 2 3 0 0 0 0 x", "nan 2 3 0 0 0 0 1"])
def test_bad_trajectory_files_name_the_line(tmp_path: Path, line: str) -> None:
    path = tmp_path / "trajectory.tum"
    path.write_text(f"1 2 3 0 0 0 0 1\n{line}\n")
    with pytest.raises(InputError, match=r"trajectory.tum, line 2: expected 8 finite numbers"):
        read_trajectory(path)


def test_missing_and_binary_trajectories(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_trajectory(tmp_path / "none.tum")
    (tmp_path / "binary.tum").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(InputError, match="not a text file"):
        read_trajectory(tmp_path / "binary.tum")


def test_what_is_written_is_read(tmp_path: Path) -> None:
    stamps = np.array([100.25, 100.5, 100.75])
    T_map_base = np.array([[0.0, 0.0, 0.0], [1.25, -0.5, 3.1], [1e-9, 7.0, -1.5]])
    write_trajectory(tmp_path / "trajectory.tum", stamps, T_map_base)
    read_stamps, read_poses = read_trajectory(tmp_path / "trajectory.tum")
    np.testing.assert_array_equal(read_stamps, stamps)
    np.testing.assert_allclose(read_poses, T_map_base, atol=5e-8)
    assert [path.name for path in tmp_path.iterdir()] == ["trajectory.tum"]
