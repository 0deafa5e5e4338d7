"""A run folder is read back as it was written, and a folder of another program as far as it goes."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from slammot_graph import Run
from slammot_graph.core.errors import InputError
from slammot_graph.core.log_info import LogInfo
from slammot_graph.core.results import RunResult
from slammot_graph.core.saved_run import end_points, moving_points, scans_of
from slammot_graph.run_folder.reader import read_run_folder
from slammot_graph.run_folder.writer import write_run_folder
from tests.rooms import ListLog, drive


@cache
def log() -> ListLog:
    return drive(30)


@cache
def result() -> RunResult:
    return Run(log()).complete()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write_run_folder(tmp_path / "run", replace(result(), log=LogInfo(path=Path("some.bag"))))
    return tmp_path / "run"


def test_what_was_written_is_read(path: Path) -> None:
    folder = read_run_folder(path)
    run = result()
    assert (folder.path, folder.method) == (path, "graph")
    assert folder.log == Path.cwd() / "some.bag"
    np.testing.assert_allclose(folder.stamps, run.stamps, atol=1e-9)
    np.testing.assert_allclose(folder.T_map_base, run.T_map_base, atol=1e-8)
    assert folder.points is not None
    np.testing.assert_array_equal(folder.points.is_moving, run.is_moving)
    np.testing.assert_allclose(folder.tracks, run.tracks[:, :9], rtol=1e-8)
    assert folder.cov_map is not None
    np.testing.assert_allclose(folder.cov_map, run.cov_map)
    np.testing.assert_array_equal(folder.grid.p_occupied == 1.0, run.grid.p_occupied > 0.8)
    np.testing.assert_array_equal(folder.grid.p_occupied == 0.0, run.grid.p_occupied < 0.2)
    np.testing.assert_allclose(folder.grid.origin, run.grid.origin, atol=1e-8)
    assert folder.grid.resolution_m == run.grid.resolution_m
    assert folder.figure("n_scans") == 30.0
    assert folder.figure("stages_ms", "step", "median") > 0.0
    assert math.isnan(folder.figure("stages_ms", "none", "median"))
    assert math.isnan(folder.figure("is_complete"))


def test_a_trajectory_alone_will_do(path: Path) -> None:
    for file in path.iterdir():
        if file.name != "trajectory.tum":
            file.unlink()
    folder = read_run_folder(path)
    assert folder.method == "run"
    assert (folder.points, folder.cov_map, folder.log) == (None, None, None)
    assert folder.tracks.shape == (0, 9)
    assert folder.grid.p_occupied.size == 0
    assert math.isnan(folder.figure("n_scans"))
    points, is_moving = end_points(folder, 3, log().scans[3])
    assert len(points) == len(is_moving) > 100
    assert not is_moving.any()


def test_maps_of_other_programs_are_read(path: Path) -> None:
    pixels = bytes([0, 254, 205, 255, 100, 1])
    (path / "map.pgm").write_bytes(b"P5\n# CREATOR: map_saver\n3 2\n255\n" + pixels)
    (path / "map.yaml").write_text(
        "# a map\nimage: 'map.pgm'\nresolution: 0.050000\norigin: [-1.0, 2.5, 0.000000] # of the corner\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    grid = read_run_folder(path).grid
    np.testing.assert_array_equal(grid.p_occupied, [[0.0, np.nan, 1.0], [1.0, 0.0, np.nan]])
    np.testing.assert_array_equal(grid.origin, [-1.0, 2.5])


@pytest.mark.parametrize(
    ("name", "content", "parts"),
    [
        ("trajectory.tum", None, ["trajectory.tum", "cannot be read"]),
        ("trajectory.tum", "", ["trajectory.tum", "holds no poses"]),
        ("points.npz", "x", ["points.npz", "not a complete"]),
        ("trajectory.tum", "1 0 0 0 0 0 0 1\n", ["points.npz", "not those of trajectory.tum"]),
        ("tracks.csv", "stamp,id,x,y\n1,2,3,4\n1,2,3,far\n", ["tracks.csv, line 3", "stamp, id, x, y"]),
        ("tracks.csv", "stamp,id\n1,2\n", ["tracks.csv, line 2"]),
        ("map.yaml", "image: map.pgm\n", ["map.yaml", "map_server"]),
        ("map.yaml", "image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0.3]\n", ["map.yaml", "turned"]),
        ("map.yaml", "image: no.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n", ["no.pgm", "picture"]),
        ("map.pgm", "P5 what", ["map.pgm", "picture"]),
        ("covariances.npz", "x", ["covariances.npz", "cov_map"]),
        ("summary.json", "{", ["summary.json", "not the JSON"]),
        ("summary.json", "[]", ["summary.json", "not the JSON"]),
    ],
)
def test_a_damaged_file_is_named(path: Path, name: str, content: str | None, parts: list[str]) -> None:
    (path / name).unlink()
    if content is not None:
        (path / name).write_text(content)
    with pytest.raises(InputError) as caught:
        read_run_folder(path)
    for part in parts:
        assert part in str(caught.value)


@pytest.mark.parametrize("name", ["points.npz", "covariances.npz"])
@pytest.mark.parametrize("change", [(b"PK\x03\x04", 6), (b"{'descr'", 1)])
def test_arrays_that_no_decoder_takes_are_told_in_a_line(
    path: Path, name: str, change: tuple[bytes, int]
) -> None:
    """One bit says that a member is encrypted; a header may end within a word: each decoder has errors of its own."""
    with np.load(path / name) as file:
        np.savez(path / name, **dict(file))  # not compressed
    data, (mark, offset) = bytearray((path / name).read_bytes()), change
    for mark_and_offset in ((mark, offset), (b"PK\x01\x02", 8)) if offset == 6 else ((mark, offset),):
        data[data.index(mark_and_offset[0]) + mark_and_offset[1]] ^= 1
    (path / name).write_bytes(data)
    with pytest.raises(InputError, match=name):
        read_run_folder(path)


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="none: no such run folder"):
        read_run_folder(tmp_path / "none")


def test_the_end_points_are_those_of_the_run(path: Path) -> None:
    folder = read_run_folder(path)
    scans = list(scans_of(folder, log()))
    assert len(scans) == 30
    for row in (0, 29):
        points, is_moving = end_points(folder, row, scans[row])
        valid = result().is_valid[row]
        np.testing.assert_allclose(points, scans[row].points(folder.T_map_base[row])[valid])
        np.testing.assert_array_equal(is_moving, result().is_moving[row][valid])
    moving = moving_points(folder, log())
    assert [len(points) for points in moving] == np.count_nonzero(result().is_moving, axis=1).tolist()


def test_tracks_of_other_programs_may_have_fewer_columns(path: Path) -> None:
    (path / "tracks.csv").write_text("id,stamp,y,x,vy\n3,0.5,2,1,-1\n")
    nan = math.nan
    np.testing.assert_array_equal(
        read_run_folder(path).tracks, [[0.5, 3.0, 1.0, 2.0, nan, -1.0, nan, nan, nan]]
    )


def shift(path: Path) -> None:
    for name, stamps in (("points.npz", "stamps"), ("covariances.npz", "stamps")):
        with np.load(path / name) as file:
            arrays = dict(file)
        arrays[stamps] = arrays[stamps] + 0.5
        np.savez(path / name, **arrays)
    lines = (path / "trajectory.tum").read_text().splitlines()
    words = [line.split(maxsplit=1) for line in lines]
    (path / "trajectory.tum").write_text("".join(f"{float(a) + 0.5:.9f} {b}\n" for a, b in words))


@pytest.mark.parametrize(
    ("change", "n_scans", "text"),
    [(shift, 30, "other times"), (lambda _: None, 20, "has 20 usable scans")],
)
def test_another_log_is_refused(path: Path, change: Callable[[Path], None], n_scans: int, text: str) -> None:
    change(path)
    with pytest.raises(InputError, match=text):
        list(scans_of(read_run_folder(path), ListLog(log().scans[:n_scans])))


def test_labels_of_fewer_beams_are_refused(path: Path) -> None:
    with np.load(path / "points.npz") as file:
        arrays = {key: value if key in ("stamps", "laser") else value[:, :7] for key, value in file.items()}
    np.savez(path / "points.npz", **arrays)
    with pytest.raises(InputError, match=r"points\.npz: has labels for 7 beams"):
        end_points(read_run_folder(path), 0, log().scans[0])


def test_the_summary_names_the_log(path: Path) -> None:
    assert json.loads((path / "summary.json").read_text())["log"] == str(Path.cwd() / "some.bag")
