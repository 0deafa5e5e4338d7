"""Which scans of a log go without odometry, and the track of all of it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slammot_graph.core.odometry_track import OdometryTrack
from slammot_graph.core.types import FloatArray
from slammot_graph.logs import open_log, source_of, write_npz_log
from slammot_graph.logs.scan_odometry import MAX_SKIPPED_RUN
from slammot_graph.simulation.log import SimulatedLog
from tests.logs.carmen_text import flaser, write_log
from tests.rooms import odometry_of

N = 30


def pose_at(track: OdometryTrack, stamp: float) -> FloatArray:
    pose = track.at(stamp)
    assert pose is not None
    return pose


def arrays(**changes: Any) -> dict[str, Any]:
    rng = np.random.default_rng(1)
    told = {
        "stamps": 100.0 + 0.1 * np.arange(N),
        "ranges": rng.uniform(1, 9, (N, 5)),
        "angle_min": -1.0,
        "angle_increment": 0.5,
        "range_min": 0.1,
        "range_max": 10.0,
        "odometry": np.column_stack([0.1 * np.arange(N), np.zeros(N), 0.02 * np.arange(N)]),
    }
    return {**told, **changes}


def written(tmp_path: Path, **changes: Any) -> Path:
    path = tmp_path / "a.npz"
    write_npz_log(path, **arrays(**changes))
    return path


def test_odometry_is_optional(tmp_path: Path) -> None:
    log = open_log(written(tmp_path, odometry=None))
    scans = list(log)
    assert len(scans) == N
    assert {(scan.T_odom_base, scan.odometry, scan.imu_yaw) for scan in scans} == {(None, None, None)}
    assert log.warnings == ["no odometry: the laser alone tells of the motion"]
    assert source_of(log)["odometry"] == "none"


def test_odometry_may_be_left_aside(tmp_path: Path) -> None:
    bad = arrays()["odometry"]
    bad[3] = np.nan
    clf = write_log(tmp_path / "a.clf", [flaser([1.0] * 180, i, (i, "nan", 0)) for i in range(3)])
    for path in (written(tmp_path, odometry=bad), clf):
        log = open_log(path, odometry=False)
        scans = list(log)
        assert len(scans) == log.n_scans
        assert all(scan.T_odom_base is None and scan.odometry is None for scan in scans)
        assert log.warnings == []
        assert source_of(log)["odometry"] == "off"


@pytest.mark.parametrize("number", [1e308, -1e308, 1e9, 2e6, np.inf, np.nan])
@pytest.mark.parametrize("column", [0, 1])
def test_a_pose_that_makes_no_sense_costs_its_scan(tmp_path: Path, number: float, column: int) -> None:
    odometry = arrays()["odometry"]
    odometry[12, column] = number
    log = open_log(written(tmp_path, odometry=odometry))
    scans = list(log)
    assert len(scans) == N - 1
    (skipped,) = log.skipped
    assert skipped.place == "row 12"
    assert ("out of any sense" if np.isfinite(number) else "not finite") in skipped.reason
    assert scans[0].odometry is not None
    np.testing.assert_allclose(pose_at(scans[0].odometry, 101.2), [1.2, 0.0, 0.24], atol=1e-9)


def test_a_heading_that_makes_no_sense_costs_its_scan(tmp_path: Path) -> None:
    odometry = arrays()["odometry"]
    odometry[12, 2] = 1e20
    log = open_log(written(tmp_path, odometry=odometry))
    assert len(list(log)) == N - 1


def test_coordinates_of_a_country_make_sense(tmp_path: Path) -> None:
    odometry = arrays()["odometry"] + [4.5e5, 5.4e6, 0.0]
    assert len(list(open_log(written(tmp_path, odometry=odometry)))) == N


def test_odometry_that_ends_leaves_the_rest_to_the_laser(tmp_path: Path) -> None:
    odometry = arrays()["odometry"]
    odometry[N // 2 :] = np.nan
    log = open_log(written(tmp_path, odometry=odometry))
    scans = list(log)
    assert [scan.T_odom_base is None for scan in scans] == [k >= N // 2 for k in range(N)]
    assert log.warnings == [
        f"{N - N // 2} of {N} scans have no odometry: the laser alone tells of the motion there"
    ]
    short = arrays()["odometry"]
    short[5 : 5 + MAX_SKIPPED_RUN] = np.nan
    assert len(list(open_log(written(tmp_path, odometry=short)))) == N - MAX_SKIPPED_RUN


def test_no_pose_that_makes_sense_is_no_odometry(tmp_path: Path) -> None:
    log = open_log(written(tmp_path, odometry=np.full((N, 3), np.nan)))
    assert len(list(log)) == N
    assert "no odometry pose is finite" in log.warnings[0]


def test_the_whole_odometry_is_shared_by_all_scans(tmp_path: Path) -> None:
    told = arrays()
    scans = list(open_log(written(tmp_path)))
    track = scans[0].odometry
    assert track is not None
    assert all(scan.odometry is track for scan in scans)
    for scan in scans:
        np.testing.assert_allclose(pose_at(track, scan.stamp), odometry_of(scan), atol=1e-12)
    np.testing.assert_allclose(track.at_many(told["stamps"]), told["odometry"], atol=1e-12)
    simulated = SimulatedLog(
        name="made",
        laser=scans[0].laser,
        stamps=told["stamps"],
        ranges=told["ranges"],
        T_odom_base=told["odometry"],
        T_world_base=told["odometry"],
        is_moving=np.zeros((N, 5), dtype=bool),
        object_id=np.full((N, 5), -1),
        objects=np.zeros((N, 0, 4)),
    )
    made = next(iter(simulated)).odometry
    assert made is not None
    np.testing.assert_allclose(made.T_odom_base, track.T_odom_base)


def test_no_track_where_stamps_go_back(tmp_path: Path) -> None:
    stamps = arrays()["stamps"]
    stamps[9] -= 0.5
    scans = list(open_log(written(tmp_path, stamps=stamps)))
    assert {scan.odometry for scan in scans} == {None}
    assert len(scans) == N


def test_equal_stamps_are_numbered_with_their_odometry(tmp_path: Path) -> None:
    log = open_log(written(tmp_path, stamps=np.zeros(N)))
    scans = list(log)
    np.testing.assert_allclose([scan.stamp for scan in scans], 0.1 * np.arange(N))
    assert "scan numbers serve as time" in log.warnings[0]
    assert scans[0].odometry is not None
    np.testing.assert_allclose(pose_at(scans[0].odometry, 0.25), [0.25, 0.0, 0.05], atol=1e-9)


def carmen(tmp_path: Path, *, offset: float = 0.0, stamp_of_odom: float = 100.0) -> Path:
    """Scans every 0.2 s of a robot at 1 m/s whose odometry is held for 0.1 s; ODOM lines every 0.1 s."""
    lines = []
    for k in range(60):
        lines.append(f"ODOM {0.1 * k + offset} 0 0 1 0 0 {stamp_of_odom + 0.1 * k} host 0.1")
        if k % 2:
            lines.append(flaser([1.0] * 180, 100.05 + 0.1 * k, (0.1 * k, 0.0, 0.0)))
    return write_log(tmp_path / "a.clf", lines)


def test_odom_lines_are_the_track_of_a_carmen_log(tmp_path: Path) -> None:
    scan = next(iter(open_log(carmen(tmp_path))))
    assert odometry_of(scan)[0] == pytest.approx(0.1)  # as the laser's line says
    assert scan.odometry is not None
    assert len(scan.odometry.stamps) == 60
    np.testing.assert_allclose(pose_at(scan.odometry, 102.55), [2.55, 0.0, 0.0], atol=1e-6)


@pytest.mark.parametrize("other", [{"offset": 3.0}, {"stamp_of_odom": 4000.0}])
def test_odom_lines_of_another_odometry_or_clock_are_no_track(
    tmp_path: Path, other: dict[str, float]
) -> None:
    scan = next(iter(open_log(carmen(tmp_path, **other))))
    assert scan.odometry is not None
    assert len(scan.odometry.stamps) == 30
    np.testing.assert_allclose(pose_at(scan.odometry, 102.35), [2.3, 0.0, 0.0], atol=1e-6)


def test_malformed_odom_lines_do_not_matter(tmp_path: Path) -> None:
    path = carmen(tmp_path)
    path.write_text(
        "ODOM 1 2\nODOM x 0 0 1 0 0 100.0 host 0.1\nODOM nan 0 0 1 0 0 100.0 host 0.1\n" + path.read_text()
    )
    track = next(iter(open_log(path))).odometry
    assert track is not None
    assert len(track.stamps) == 60
