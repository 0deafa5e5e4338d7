from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slammot_graph.core.errors import ConfigError, InputError
from slammot_graph.logs import open_log, source_of, write_npz_log
from tests.logs.compare import assert_same_scans


def example_arrays(n_scans: int = 4, n_beams: int = 5) -> dict[str, Any]:
    rng = np.random.default_rng(1)
    return {
        "stamps": 100.0 + 0.1 * np.arange(n_scans),
        "ranges": rng.uniform(1, 9, (n_scans, n_beams)),
        "angle_min": -1.0,
        "angle_increment": 0.5,
        "range_min": 0.1,
        "range_max": 10.0,
        "odometry": rng.normal(size=(n_scans, 3)),
        "laser_pose": np.array([0.2, -0.1, 0.3]),
    }


def test_round_trip_with_truth(tmp_path: Path) -> None:
    arrays = example_arrays()
    truth = {
        "poses": arrays["odometry"] + 0.1,
        "is_moving": arrays["ranges"] > 5.0,
        "object_id": np.where(arrays["ranges"] > 5.0, 3, -1),
    }
    write_npz_log(tmp_path / "a.npz", **arrays, **truth)
    log = open_log(tmp_path / "a.npz")
    assert log.n_scans == 4
    scans = list(log)
    for i, scan in enumerate(scans):
        assert (scan.index, scan.stamp) == (i, arrays["stamps"][i])
        np.testing.assert_array_equal(scan.ranges, arrays["ranges"][i])
        np.testing.assert_array_equal(scan.T_odom_base, arrays["odometry"][i])
        assert scan.truth is not None
        assert scan.truth.is_moving is not None
        np.testing.assert_array_equal(scan.truth.T_world_base, truth["poses"][i])
        np.testing.assert_array_equal(scan.truth.is_moving, truth["is_moving"][i])
        np.testing.assert_array_equal(scan.truth.object_id, truth["object_id"][i])
        assert scan.truth.is_moving.dtype == np.bool_
        assert scan.laser is scans[0].laser
    assert scans[0].laser.T_base_laser == (0.2, -0.1, 0.3)
    assert (scans[0].laser.angle_min, scans[0].laser.n_beams, scans[0].laser.range_max) == (-1.0, 5, 10.0)
    assert_same_scans(list(log), scans)


def test_what_was_used_is_told(tmp_path: Path) -> None:
    path = _written(tmp_path, example_arrays())
    assert source_of(open_log(path)) == {
        "laser_pose": (0.2, -0.1, 0.3),
        "laser_pose_from": "the key laser_pose",
    }
    log = open_log(path, laser_pose=(1.0, 0.0, 0.5))
    assert next(iter(log)).laser.T_base_laser == (1.0, 0.0, 0.5)
    assert source_of(log) == {"laser_pose": (1.0, 0.0, 0.5), "laser_pose_from": "given"}
    write_npz_log(path, **example_arrays(), poses=np.zeros((4, 3)), poses_are_estimates=True)
    assert source_of(open_log(path))["poses"] == "estimates"


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_a_given_mounting_is_finite(tmp_path: Path, number: float) -> None:
    with pytest.raises(ConfigError, match="three finite numbers"):
        open_log(_written(tmp_path, example_arrays()), laser_pose=(0.0, number, 0.0))


def test_partial_truth_other_keys_and_other_kinds_of_numbers(tmp_path: Path) -> None:
    arrays = example_arrays()
    arrays["ranges"] = np.asfortranarray(arrays["ranges"].astype(np.float32))
    arrays["range_max"] = [10]
    np.savez(tmp_path / "a.npz", **arrays, poses=np.zeros((4, 3), dtype=int), note="hello", extra=np.eye(2))
    scan = next(iter(open_log(tmp_path / "a.npz")))
    assert scan.ranges.dtype == np.float64
    assert scan.ranges.flags.c_contiguous
    assert scan.laser.range_max == 10.0
    assert scan.truth is not None
    assert scan.truth.is_moving is None
    np.testing.assert_array_equal(scan.truth.T_world_base, np.zeros(3))
    assert next(iter(open_log(_written(tmp_path, example_arrays())))).truth is None


def test_bad_rows_are_left_out(tmp_path: Path) -> None:
    arrays = example_arrays(n_scans=6)
    arrays["ranges"][1] = [np.nan, np.inf, -np.inf, -1.0, 0.0]
    arrays["ranges"][2, :4] = [np.nan, np.inf, -np.inf, -1.0]
    arrays["odometry"][3, 2] = np.inf
    arrays["stamps"][4] = np.nan
    log = open_log(_written(tmp_path, arrays))
    assert [scan.index for scan in log] == [0, 1, 2]
    assert [(x.place, x.reason) for x in log.skipped] == [
        ("row 1", "no beam has a finite, positive range"),
        ("row 3", "its odometry is not finite"),
        ("row 4", "its stamp is not finite"),
    ]
    assert log.n_scans == 6


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("stamps", np.zeros(3), r"`stamps` has shape \(3,\) where \(4,\)"),
        ("ranges", np.zeros(4), "`ranges` has shape"),
        ("ranges", np.zeros((0, 5)), "no scans"),
        ("ranges", np.zeros((4, 0)), "at least one beam"),
        ("odometry", np.zeros((4, 2)), "`odometry` has shape"),
        ("laser_pose", np.zeros(2), "`laser_pose` has shape"),
        ("laser_pose", np.array([0.0, np.nan, 0.0]), "`laser_pose` is not finite"),
        ("angle_min", np.zeros(4), "`angle_min` has shape"),
        ("angle_increment", 0.0, "angle_increment is zero"),
        ("angle_min", np.nan, "not finite"),
        ("range_max", 0.05, "range_min < range_max"),
        ("poses", np.zeros((3, 3)), "`poses` has shape"),
        ("is_moving", np.zeros((4, 4), dtype=bool), "`is_moving` has shape"),
        ("object_id", np.zeros(4, dtype=int), "`object_id` has shape"),
        ("stamps", np.array(["a", "b", "c", "d"]), "`stamps` is of type"),
    ],
)
def test_wrong_shapes_and_kinds(tmp_path: Path, key: str, value: Any, text: str) -> None:
    arrays = {**example_arrays(), key: value}
    with pytest.raises(InputError, match=text) as caught:
        write_npz_log(tmp_path / "b.npz", **arrays)
    assert not (tmp_path / "b.npz").exists()
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(InputError, match=text) as caught:
        open_log(tmp_path / "a.npz")
    assert str(tmp_path / "a.npz") in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_keys_are_listed(tmp_path: Path) -> None:
    arrays = example_arrays()
    del arrays["stamps"], arrays["laser_pose"]
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(InputError, match="lacks stamps, laser_pose"):
        open_log(tmp_path / "a.npz")


def test_object_arrays_are_refused(tmp_path: Path) -> None:
    arrays = {**example_arrays(), "odometry": np.array([{"x": 1}, 2, 3, 4], dtype=object)}
    np.savez(tmp_path / "a.npz", allow_pickle=True, **arrays)
    with pytest.raises(InputError, match=r"`odometry`.*numbers"):
        open_log(tmp_path / "a.npz")


@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
def test_truncated(tmp_path: Path, share: float) -> None:
    path = _written(tmp_path, example_arrays(n_scans=200))
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError, match="npz"):
        open_log(path)


def test_damaged_inside(tmp_path: Path) -> None:
    path = _written(tmp_path, example_arrays(n_scans=200))
    data = bytearray(path.read_bytes())
    middle = data.index(b"ranges.npy") + 200
    data[middle : middle + 500] = bytes(500)
    path.write_bytes(data)
    with pytest.raises(InputError, match="`ranges`"):
        open_log(path)


def test_not_an_npz(tmp_path: Path) -> None:
    (tmp_path / "a.npz").write_text("hello")
    with pytest.raises(InputError, match=r"not a .npz file"):
        open_log(tmp_path / "a.npz")
    np.save(tmp_path / "a.npy", np.eye(2))
    with pytest.raises(InputError, match=r"not a .npy file"):
        open_log(tmp_path / "a.npy")


def test_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be written"):
        write_npz_log(tmp_path / "nowhere" / "a.npz", **example_arrays())


def _written(folder: Path, arrays: dict[str, Any]) -> Path:
    write_npz_log(folder / "written.npz", **arrays)
    return folder / "written.npz"
