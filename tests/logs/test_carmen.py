import math
from pathlib import Path

import numpy as np
import pytest

from slammot_graph.core.errors import InputError
from slammot_graph.logs import open_log, source_of
from tests.logs.carmen_text import flaser, robotlaser, write_log
from tests.logs.compare import assert_same_scans

GOOD = [1.0 + 0.01 * i for i in range(180)]


@pytest.mark.parametrize("name", ["a.clf", "a.log", "a.clf.gz", "a.clf.bz2", "a.txt"])
def test_reads_flaser_plain_and_compressed(tmp_path: Path, name: str) -> None:
    no_return = [*GOOD[:-1], 81.91]
    path = write_log(
        tmp_path / name,
        [
            "# a comment",
            flaser(GOOD, 10.5, (1.0, 2.0, 0.25)),
            "ODOM 9 9 9 0 0 0 10.6 h 0.6",
            flaser(no_return, 10.7, (1.5, 2.0, 0.5)),
        ],
    )
    log = open_log(path)
    assert log.path == path
    assert log.n_scans == 2
    first, second = log
    assert (first.index, first.stamp, second.index, second.stamp) == (0, 10.5, 1, 10.7)
    np.testing.assert_array_equal(first.ranges, GOOD)
    np.testing.assert_array_equal(second.T_odom_base, [1.5, 2.0, 0.5])
    assert first.laser is second.laser
    assert first.laser.angle_min == -math.pi / 2
    assert first.laser.angle_increment == pytest.approx(math.radians(1.0))
    assert first.laser.range_max == 81.91
    assert first.laser.T_base_laser == (0.0, 0.0, 0.0)
    assert log.skipped == []
    assert log.warnings == []
    assert_same_scans(list(log), [first, second])


@pytest.mark.parametrize(
    ("n_beams", "step", "last"), [(180, 1.0, 89), (181, 1, 90), (360, 0.5, 89.5), (361, 0.5, 90)]
)
def test_flaser_angles(tmp_path: Path, n_beams: int, step: float, last: float) -> None:
    (scan,) = open_log(write_log(tmp_path / "a.clf", [flaser([2.0] * n_beams, 1.0)]))
    assert scan.laser.angle_increment == pytest.approx(math.radians(step))
    assert scan.laser.angles_base[-1] == pytest.approx(math.radians(last))


def test_file_order_is_kept_and_jumps_are_noted_once(tmp_path: Path) -> None:
    stamps = [100.0, 100.2, 99.9, 100.3, 100.1, 100.4, 200.0]
    log = open_log(write_log(tmp_path / "a.clf", [flaser(GOOD, t) for t in stamps]))
    for _ in range(2):
        assert [scan.stamp for scan in log] == stamps
        backward, forward = log.warnings
        assert "backward 2 times, by up to 0.3 s" in backward
        assert "60 s 1 times, by up to 99.6 s" in forward


def test_mounting_is_the_laser_seen_from_the_base(tmp_path: Path) -> None:
    mounting = (0.22, -0.05, 3.1415)
    lines = []
    for i in range(20):
        x, y, theta = 0.3 * i, -0.1 * i, 0.4 * i
        c, s = math.cos(theta), math.sin(theta)
        laser = (x + c * 0.22 + s * 0.05, y + s * 0.22 - c * 0.05, math.remainder(theta + 3.1415, math.tau))
        lines.append(flaser(GOOD, i, (x, y, theta), [f"{v:.6f}" for v in laser]))
    scans = list(open_log(write_log(tmp_path / "a.clf", lines)))
    assert len({id(scan.laser) for scan in scans}) == 1
    assert scans[0].laser.T_base_laser == pytest.approx(mounting, abs=1.1e-4)


def test_corrected_poses_are_no_mounting(tmp_path: Path) -> None:
    lines = [flaser(GOOD, i, (i, 0.0, 0.0), (i, 0.3 * i, 0.0)) for i in range(10)]
    log = open_log(write_log(tmp_path / "a.clf", lines))
    assert next(iter(log)).laser.T_base_laser == (0.0, 0.0, 0.0)
    assert "corrected poses" in log.warnings[0]


def test_robotlaser_geometry_changes_from_scan_to_scan(tmp_path: Path) -> None:
    lines = [
        robotlaser([3.0] * 181, 1.0, robot=(0, 0, 0), laser=(0.22, 0, 0)),
        robotlaser([3.0] * 180, 2.0, start=-1.566433, robot=(1, 0, 0), laser=(1.22, 0, 0)),
        robotlaser(
            [3.0] * 181, 3.0, robot=(1, 0, 1.570796), laser=(1, 0.22, 1.570796), remissions=[7.0] * 181
        ),
    ]
    log = open_log(write_log(tmp_path / "a.clf", lines))
    a, b, c = log
    assert a.laser is c.laser
    assert (a.laser.n_beams, b.laser.n_beams) == (181, 180)
    assert (a.laser.angle_min, b.laser.angle_min) == (-1.570796, -1.566433)
    assert a.laser.range_max == 81.9
    assert a.laser.T_base_laser == b.laser.T_base_laser == (0.22, 0.0, 0.0)
    np.testing.assert_array_equal(c.T_odom_base, [1.0, 0.0, 1.570796])
    assert log.skipped == []


def test_where_the_mounting_comes_from_is_told(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.clf", [robotlaser(GOOD, 1.0)])
    told = source_of(open_log(path))
    assert told["laser_pose_from"] == "the laser's lines"
    assert told["laser_pose"] == next(iter(open_log(path))).laser.T_base_laser
    log = open_log(path, laser_pose=(0.1, 0.0, -3.0))
    assert next(iter(log)).laser.T_base_laser == (0.1, 0.0, -3.0)
    assert source_of(log) == {"laser_pose": (0.1, 0.0, -3.0), "laser_pose_from": "given"}


def test_one_kind_of_laser_line_is_read(tmp_path: Path) -> None:
    lines = [flaser(GOOD, 1.0), flaser([9.0] * 180, 1.1, kind="RLASER"), robotlaser(GOOD, 1.2)]
    log = open_log(write_log(tmp_path / "a.clf", lines))
    assert log.n_scans == 1
    assert len(list(log)) == 1
    assert log.warnings == [
        "ROBOTLASER1 lines are not used, as the log has FLASER lines",
        "RLASER lines are not used, as the log has FLASER lines",
    ]
    rear = open_log(write_log(tmp_path / "rear.clf", lines[1:2]))
    assert len(list(rear)) == 1
    assert "rear laser only" in rear.warnings[0]


BAD_LINES = {
    "malformed reading": (flaser(["1.2x", *GOOD[1:]], 2.0), "could not convert"),
    "malformed count": ("FLASER many 1 2 3", "invalid literal"),
    "negative count": ("FLASER -3 1 2 3", "a count of -3"),
    "no tokens": ("FLASER ", "truncated"),
    "count against tokens": (flaser(GOOD, 2.0).replace("FLASER 180", "FLASER 181"), "tokens where"),
    "cut short": (flaser(GOOD, 2.0)[:300], "tokens where"),
    "other beam count": (flaser([1.0] * 181, 2.0), "181 beams where the log's first scan has 180"),
    "odometry not finite": (flaser(GOOD, 2.0, (0.0, "nan", 0.0)), "odometry is not finite"),
    "malformed odometry": (flaser(GOOD, 2.0, (0.0, "?", 0.0)), "could not convert"),
    "stamp not finite": (flaser(GOOD, "nan"), "stamp is not finite"),
    "malformed stamp": (flaser(GOOD, "noon"), "could not convert"),
    "all nan": (flaser(["nan"] * 180, 2.0), "no beam"),
    "all negative": (flaser([-1.0] * 180, 2.0), "no beam"),
    "all infinite": (flaser(["inf"] * 180, 2.0), "no beam"),
    "all bad in several ways": (flaser([0, "nan", "-inf", -2] * 45, 2.0), "no beam"),
}


@pytest.mark.parametrize("case", BAD_LINES)
def test_a_bad_scan_is_left_out_with_place_and_reason(tmp_path: Path, case: str) -> None:
    line, reason = BAD_LINES[case]
    log = open_log(write_log(tmp_path / "a.clf", [flaser(GOOD, 1.0), "# x", line, flaser(GOOD, 3.0)]))
    assert log.n_scans == 3
    for _ in range(2):
        assert [(scan.index, scan.stamp) for scan in log] == [(0, 1.0), (1, 3.0)]
        (skipped,) = log.skipped
        assert skipped.place == "line 3"
        assert reason in skipped.reason
        assert "\n" not in skipped.reason


def test_single_bad_beams_are_kept_as_they_are(tmp_path: Path) -> None:
    readings = ["nan", "inf", "-inf", -1.0, *GOOD[4:]]
    log = open_log(write_log(tmp_path / "a.clf", [flaser(readings, 1.0)]))
    (scan,) = log
    np.testing.assert_array_equal(scan.ranges[:4], [np.nan, np.inf, -np.inf, -1.0])
    assert scan.laser.range_max == pytest.approx(max(GOOD))
    assert not scan.is_valid()[:4].any()


def test_an_absurd_reading_does_not_set_the_limit(tmp_path: Path) -> None:
    log = open_log(write_log(tmp_path / "a.clf", [flaser([1e9, *GOOD[1:-1], 81.91], 1.0)]))
    assert next(iter(log)).laser.range_max == 81.91


def test_more_different_readings_than_are_held(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    readings = rng.uniform(1.0, 80.0, size=(700, 180)).round(6)
    log = open_log(write_log(tmp_path / "a.clf", [flaser(row.tolist(), i) for i, row in enumerate(readings)]))
    assert next(iter(log)).laser.range_max == readings.max()


def test_no_usable_scan_at_all(tmp_path: Path) -> None:
    log = open_log(write_log(tmp_path / "a.clf", [flaser(["nan"] * 180, 1.0), "FLASER x"]))
    assert log.n_scans == 2
    assert list(log) == []
    assert [x.place for x in log.skipped] == ["line 1", "line 2"]


def test_no_laser_lines(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.clf", ["ODOM 0 0 0 0 0 0 1.0 host 0.1"])
    with pytest.raises(InputError, match="no laser lines") as caught:
        open_log(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["a.clf.gz", "a.clf.bz2"])
@pytest.mark.parametrize("n_bytes", [10, 2000, -5])
def test_truncated_compressed_file(tmp_path: Path, name: str, n_bytes: int) -> None:
    rng = np.random.default_rng(3)
    lines = [flaser(row.tolist(), i) for i, row in enumerate(rng.uniform(1, 9, (50, 180)).round(3))]
    path = write_log(tmp_path / name, lines)
    path.write_bytes(path.read_bytes()[:n_bytes])
    with pytest.raises(InputError, match="again") as caught:
        open_log(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("name", ["a.clf.gz", "a.clf.bz2"])
def test_damaged_compressed_file(tmp_path: Path, name: str) -> None:
    rng = np.random.default_rng(3)
    path = write_log(
        tmp_path / name, [flaser(row.tolist(), 1) for row in rng.uniform(1, 9, (50, 180)).round(3)]
    )
    data = bytearray(path.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 200] = bytes(200)
    path.write_bytes(data)
    with pytest.raises(InputError, match="copy"):
        open_log(path)


def test_iterations_do_not_disturb_each_other_and_may_be_abandoned(tmp_path: Path) -> None:
    lines = [flaser(GOOD, 1.0), "FLASER x", *(flaser(GOOD, t) for t in (2.0, 3.0))]
    log = open_log(write_log(tmp_path / "a.clf.bz2", lines))
    first, second = iter(log), iter(log)
    assert [next(first).stamp, next(second).stamp, next(first).stamp] == [1.0, 1.0, 2.0]
    del first
    assert [scan.stamp for scan in second] == [2.0, 3.0]
    assert len(log.skipped) == 1
    iter(log)
    assert log.skipped == []


def test_file_that_goes_away(tmp_path: Path) -> None:
    log = open_log(write_log(tmp_path / "a.clf", [flaser(GOOD, 1.0)]))
    log.path.unlink()
    with pytest.raises(InputError, match="cannot be read"):
        list(log)
