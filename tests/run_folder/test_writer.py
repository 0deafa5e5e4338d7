"""The run folder is a contract: what is written is read back byte by byte, as other programs would."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from slammot_graph import Run
from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.log_info import LogInfo
from slammot_graph.core.results import GridMap, RunResult
from slammot_graph.run_folder.directory import prepare_output
from slammot_graph.run_folder.points import read_points
from slammot_graph.run_folder.tum import read_trajectory
from slammot_graph.run_folder.writer import write_run_folder
from tests.rooms import drive

FILES = {
    "trajectory.tum",
    "points.npz",
    "tracks.csv",
    "tracks_online.csv",
    "map.pgm",
    "map.yaml",
    "graph.g2o",
    "map.slam",
    "covariances.npz",
    "summary.json",
}


@cache
def result() -> RunResult:
    return Run(drive(40)).complete()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_run_folder(tmp_path / "run", result())
    return tmp_path / "run"


def test_a_run_folder_holds_the_files_of_the_contract(folder: Path) -> None:
    assert {path.name for path in folder.iterdir()} == FILES


def test_the_trajectory_is_read_back(folder: Path) -> None:
    stamps, poses = read_trajectory(folder / "trajectory.tum")
    np.testing.assert_allclose(stamps, result().stamps, atol=1e-6)
    np.testing.assert_allclose(poses[:, :2], result().T_map_base[:, :2], atol=1e-8)
    np.testing.assert_allclose(se2.wrap_angle(poses[:, 2] - result().T_map_base[:, 2]), 0.0, atol=1e-7)


def test_a_line_of_the_trajectory_is_tum(folder: Path) -> None:
    fields = (folder / "trajectory.tum").read_text().splitlines()[7].split()
    assert len(fields) == 8
    assert fields[3:6] == ["0", "0", "0"]
    assert len(fields[0].split(".")[1]) >= 6
    theta = result().T_map_base[7, 2]
    assert float(fields[6]) == pytest.approx(np.sin(theta / 2), abs=1e-8)
    assert float(fields[7]) == pytest.approx(np.cos(theta / 2), abs=1e-8)


def test_points_are_read_back(folder: Path) -> None:
    points = read_points(folder / "points.npz")
    np.testing.assert_array_equal(points.is_moving, result().is_moving)
    np.testing.assert_array_equal(points.is_moving_online, result().is_moving_online)
    np.testing.assert_array_equal(points.is_valid, result().is_valid)
    assert points.p_moving.dtype == np.float16
    assert np.isnan(points.p_moving[~points.is_valid]).all()


def test_tracks_have_their_header_and_columns(folder: Path) -> None:
    lines = (folder / "tracks.csv").read_text().splitlines()
    assert lines[0] == "stamp,id,x,y,vx,vy,var_x,cov_xy,var_y,is_seen,class,probability,size"
    assert len(lines) == 1 + len(result().tracks)
    cells = [line.split(",") for line in lines[1:]]
    values = np.array([[float(v) for v in row[:10]] for row in cells])
    np.testing.assert_allclose(values[:, :9], result().tracks[:, :9], rtol=1e-7, atol=1e-7)
    assert values[:, 9].tolist() == result().is_track_seen.tolist()
    of = {str(one.track_id): one for one in result().objects}
    assert len(of) > 0
    assert all(of[row[1]].kind == row[10] for row in cells)
    assert float(cells[0][12]) == pytest.approx(of[cells[0][1]].size_m)


def test_tracks_of_the_time_tell_where_the_robot_was_believed_to_be(folder: Path) -> None:
    lines = (folder / "tracks_online.csv").read_text().splitlines()
    assert lines[0].split(",")[9:] == ["is_seen", "base_x", "base_y", "base_yaw"]
    values = np.array([[float(v) for v in line.split(",")] for line in lines[1:]])
    np.testing.assert_allclose(values[:, :9], result().tracks_online[:, :9], rtol=1e-7, atol=1e-7)
    rows = np.searchsorted(result().stamps, values[:, 0] - 1e-6)
    np.testing.assert_allclose(values[:, 10:], result().T_map_base_online[rows], rtol=1e-7, atol=1e-7)


def test_the_map_is_upside_up(tmp_path: Path) -> None:
    p = np.array([[0.9, 0.1, np.nan], [0.5, 0.1, 0.1]])
    grid = GridMap(p_occupied=p, resolution_m=0.25, origin=np.array([-1.0, 2.0]))
    write_run_folder(tmp_path, replace(result(), grid=grid))
    header, pixels = (tmp_path / "map.pgm").read_bytes().split(b"\n255\n")
    assert header == b"P5\n3 2"
    assert list(pixels) == [205, 254, 254, 0, 254, 205]
    settings = dict(line.split(": ", 1) for line in (tmp_path / "map.yaml").read_text().splitlines())
    assert settings["image"] == "map.pgm"
    assert float(settings["resolution"]) == 0.25
    assert json.loads(settings["origin"]) == [-1.0, 2.0, 0.0]
    assert settings["negate"] == "0"
    assert (float(settings["occupied_thresh"]), 0.19 < float(settings["free_thresh"]) <= 0.2) == (0.8, True)


def test_the_graph_is_g2o_in_full_precision(folder: Path) -> None:
    lines = [line.split() for line in (folder / "graph.g2o").read_text().splitlines()]
    vertices = np.array([[float(v) for v in line[2:]] for line in lines if line[0] == "VERTEX_SE2"])
    np.testing.assert_array_equal(vertices, result().nodes)
    edges = [line for line in lines if line[0] == "EDGE_SE2"]
    assert len(edges) == len(result().edges)
    first = result().edges[0]
    upper = first.information[np.triu_indices(3)]
    assert [int(v) for v in edges[0][1:3]] == [first.from_node, first.to_node]
    np.testing.assert_array_equal([float(v) for v in edges[0][3:]], [*first.T_from_to, *upper])


def test_a_vertex_names_its_scan(folder: Path) -> None:
    T_map_base = read_trajectory(folder / "trajectory.tum")[1]
    vertices = [line.split() for line in (folder / "graph.g2o").read_text().splitlines() if "VERTEX" in line]
    with np.load(folder / "covariances.npz") as file:
        node_scans = file["node_scans"]
    assert len(node_scans) == len(vertices) > 1
    np.testing.assert_array_equal(node_scans, result().node_scans)
    positions = [[float(v) for v in vertex[2:4]] for vertex in vertices]
    np.testing.assert_allclose(T_map_base[node_scans, :2], positions, atol=1e-8)


def test_without_a_graph_there_is_no_g2o(folder: Path) -> None:
    """Nor does one of an earlier run stay."""
    write_run_folder(folder, Run(drive(5), "odometry").complete())
    assert {path.name for path in folder.iterdir()} == FILES - {"graph.g2o", "map.slam"}
    with np.load(folder / "covariances.npz") as file:
        assert file["node_scans"].shape == (0,)


def test_the_summary_tells_what_of_the_log_was_used(tmp_path: Path) -> None:
    log = drive(5)
    quiet_run = Run(log, "odometry").complete()
    log.warnings.append("tf does not tell")
    log.source = {"scan_topic": "/scan"}  # type: ignore[attr-defined]
    write_run_folder(tmp_path / "plain", replace(quiet_run, log=LogInfo(path=Path("some.bag"))))
    write_run_folder(tmp_path / "quiet", quiet_run)
    write_run_folder(tmp_path / "log", Run(log, "odometry").complete())
    plain, quiet, told = (
        json.loads((tmp_path / name / "summary.json").read_text()) for name in ("plain", "quiet", "log")
    )
    assert (plain["source"], plain["warnings"], plain["n_scans_of_log"]) == ({}, [], None)
    assert plain["log"] == str(Path("some.bag").absolute())
    assert (quiet["source"], quiet["log"]) == ({}, str(Path("list.log").absolute()))
    assert (told["source"], told["warnings"]) == ({"scan_topic": "/scan"}, ["tf does not tell"])
    assert told["n_scans_of_log"] == 5


def test_covariances_are_read_back(folder: Path) -> None:
    with np.load(folder / "covariances.npz") as file:
        np.testing.assert_array_equal(file["cov_map"], result().cov_map)
        np.testing.assert_array_equal(file["cov_anchor_base"], result().cov_anchor_base)
        np.testing.assert_array_equal(file["stamps"], result().stamps)


def test_the_summary_counts(folder: Path) -> None:
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["method"] == "graph"
    assert summary["n_scans"] == 40
    assert summary["n_nodes"] == len(result().nodes)
    assert summary["n_loop_closures"] == sum(edge.kind == "closure" for edge in result().edges)
    assert summary["stages_ms"]["step"]["median"] == pytest.approx(
        np.median(result().stage_ms["step"]), rel=1e-3
    )
    assert summary["stages_ms"]["step"]["p95"] >= summary["stages_ms"]["step"]["median"]
    assert summary["config"]["localizer"]["type"] == "ScanToMapConfig"
    assert {"gtsam", "numpy", "python"} <= set(summary["versions"])
    assert summary["scans_per_s"] > 0.0
    assert summary["peak_memory_mb"] > 10.0
    assert summary["is_complete"] is True
    steps = np.diff(result().T_map_base[:, :2], axis=0)
    assert summary["path_length_m"] == pytest.approx(np.hypot(*steps.T).sum())
    assert summary["duration_s"] == pytest.approx(3.9)
    assert summary["n_tracks"] == len(set(result().tracks[:, 1]))


def test_a_run_is_not_replaced_by_accident(folder: Path) -> None:
    (folder / "mine.txt").write_text("notes")
    with pytest.raises(InputError, match="--overwrite"):
        prepare_output(folder, overwrite=False)
    prepare_output(folder, overwrite=True)
    assert [path.name for path in folder.iterdir()] == ["mine.txt"]


def test_a_folder_of_something_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("text")
    with pytest.raises(InputError, match=r"thesis\.tex"):
        prepare_output(tmp_path, overwrite=True)
    assert (tmp_path / "thesis.tex").read_text() == "text"


def test_a_file_is_no_run_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is a file"):
        prepare_output(tmp_path / "file", overwrite=True)


def test_folders_above_are_made(tmp_path: Path) -> None:
    prepare_output(tmp_path / "a" / "b", overwrite=False)
    assert (tmp_path / "a" / "b").is_dir()


def test_points_that_are_cut_short_are_refused(folder: Path) -> None:
    whole = (folder / "points.npz").read_bytes()
    (folder / "points.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"points\.npz"):
        read_points(folder / "points.npz")
    with pytest.raises(InputError, match="nothing"):
        read_points(folder / "nothing.npz")


@pytest.mark.parametrize("name", sorted(FILES))
def test_a_file_that_cannot_be_written_keeps_no_other_from_it(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()  # in its way
    (tmp_path / name / "x").touch()
    with pytest.raises(InputError, match=name.replace(".", r"\.")):
        write_run_folder(tmp_path, result())
    without = {name, "map.yaml"} if name == "map.pgm" else {name}  # it tells of a picture that is there
    assert {path.name for path in tmp_path.iterdir() if path.is_file()} == FILES - without
