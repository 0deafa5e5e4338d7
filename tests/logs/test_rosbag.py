"""Bags in each format, made for each case.

Over 400 lines because each case builds a bag of its own.
"""

import math
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slammot_graph.core.errors import InputError
from slammot_graph.logs import LaserLog, open_log, source_of
from tests.logs import bag_files as bf
from tests.logs.compare import assert_same_scans
from tests.rooms import odometry_of

T0 = 1_600_000_000.0
Pose = tuple[float, float, float]
MakePose = Callable[..., bf.Sent]
SCAN_STAMPS = [T0 + 0.25 + 0.125 * i for i in range(6)]
ODOMETRY_STAMPS = [T0 + 0.1 * i for i in range(13)]


def pose_at(stamp: float) -> Pose:
    """A robot that turns through 180 degrees while it drives."""
    t = stamp - T0
    return 2.0 * t, -t, math.remainder(2.5 + 2.0 * t, math.tau)


def scans(**changes: Any) -> list[bf.Sent]:
    return [bf.scan(t, (1.0 + i, 2.0, np.inf), **changes) for i, t in enumerate(SCAN_STAMPS)]


def odometry(make: MakePose = bf.odometry, **changes: Any) -> list[bf.Sent]:
    return [make(t, pose_at(t), **changes) for t in ODOMETRY_STAMPS]


def mounting(**changes: Any) -> list[bf.Sent]:
    return [bf.transform(T0, "base_link", "laser", (0.5, -0.25, 0.75), **changes)]


def refusal(path: Path, **topics: Any) -> str:
    with pytest.raises(InputError) as caught:
        open_log(path, **topics)
    text = str(caught.value)
    assert str(path) in text
    assert "\n" not in text
    return text


def assert_odometry(log: LaserLog, poses: Callable[[float], Pose] = pose_at) -> None:
    found = list(log)
    assert found
    for scan in found:
        np.testing.assert_allclose(odometry_of(scan), poses(scan.stamp), atol=1e-5)


@pytest.mark.parametrize("kind", bf.FORMATS)
def test_reads_every_bag_format(tmp_path: Path, kind: str) -> None:
    log = open_log(bf.write_bag(tmp_path, scans() + odometry() + mounting(), kind))
    assert log.n_scans == 6
    found = list(log)
    assert [scan.index for scan in found] == list(range(6))
    np.testing.assert_allclose([scan.stamp for scan in found], SCAN_STAMPS, rtol=0, atol=1e-6)
    np.testing.assert_array_equal([scan.ranges[0] for scan in found], [1, 2, 3, 4, 5, 6])
    assert found[0].ranges.dtype == np.float64
    assert np.isinf(found[0].ranges[2])
    laser = found[0].laser
    assert all(scan.laser is laser for scan in found)
    assert (laser.angle_min, laser.angle_increment, laser.n_beams) == (-0.5, 0.25, 3)
    assert (laser.range_min, laser.range_max) == (0.125, 16.0)
    assert laser.T_base_laser == pytest.approx((0.5, -0.25, 0.75))
    assert_odometry(log)
    assert log.skipped == []
    assert log.warnings == []
    assert_same_scans(list(log), found)


@pytest.mark.parametrize("kind", ["sqlite3", "mcap"])
def test_bag_file_without_its_folder(tmp_path: Path, kind: str) -> None:
    folder = bf.write_bag(tmp_path, scans() + odometry() + mounting(), kind)
    expected = list(open_log(folder))
    (file,) = (x for x in folder.iterdir() if x.suffix in (".db3", ".mcap"))
    assert_same_scans(list(open_log(file)), expected)
    lone = shutil.copy(file, tmp_path / file.name)
    assert_same_scans(list(open_log(lone)), expected)
    (folder / "metadata.yaml").unlink()
    assert_same_scans(list(open_log(folder)), expected)


def test_iteration_may_be_abandoned(tmp_path: Path) -> None:
    for kind in bf.FORMATS:
        iterator = iter(open_log(bf.write_bag(tmp_path, scans() + odometry() + mounting(), kind)))
        next(iterator)
        del iterator


@pytest.mark.parametrize("make", [bf.pose_stamped, bf.pose_with_covariance])
def test_poses_as_odometry(tmp_path: Path, make: MakePose) -> None:
    assert_odometry(open_log(bf.write_bag(tmp_path, scans() + odometry(make) + mounting())))


@pytest.mark.parametrize("base", ["base_link", "base_footprint"])
def test_tf_as_odometry(tmp_path: Path, base: str) -> None:
    broadcast = [bf.transform(t, "/odom", base, pose_at(t), topic="/tf") for t in ODOMETRY_STAMPS]
    fixed = bf.transform(T0, base, "laser", (0.5, -0.25, 0.75), topic="/tf")
    log = open_log(bf.write_bag(tmp_path, [*scans(), *broadcast, fixed]))
    assert_odometry(log)
    assert next(iter(log)).laser.T_base_laser == pytest.approx((0.5, -0.25, 0.75))


def test_odometry_is_preferred_to_poses_and_tf(tmp_path: Path) -> None:
    others = [bf.pose_stamped(t, (9, 9, 0)) for t in ODOMETRY_STAMPS]
    broadcast = [bf.transform(t, "odom", "base_link", (8, 8, 0), topic="/tf") for t in ODOMETRY_STAMPS]
    path = bf.write_bag(tmp_path, scans() + odometry() + others + broadcast + mounting())
    assert_odometry(open_log(path))
    assert_odometry(open_log(path, odom_topic="/pose"), lambda _: (9, 9, 0))
    assert_odometry(open_log(path, odom_topic="/tf"), lambda _: (8, 8, 0))


def test_a_goal_is_not_odometry(tmp_path: Path) -> None:
    many_scans = [bf.scan(T0 + 0.05 * i) for i in range(21)]
    goals = [bf.pose_stamped(T0 + i, (5, 5, 0), topic="/goal") for i in range(2)]
    broadcast = [bf.transform(t, "odom", "base_link", pose_at(t), topic="/tf") for t in ODOMETRY_STAMPS]
    assert_odometry(open_log(bf.write_bag(tmp_path, many_scans + goals + broadcast + mounting())))
    (tmp_path / "log.bag").unlink()
    log = open_log(bf.write_bag(tmp_path, many_scans + goals))
    assert {scan.T_odom_base for scan in log} == {None}
    assert any("name one of /goal with --odom-topic" in x for x in log.warnings)


def test_several_topics_have_to_be_chosen_from(tmp_path: Path) -> None:
    more = scans(topic="/rear/scan") + odometry(topic="/wheel")
    path = bf.write_bag(tmp_path, scans() + odometry() + more + mounting())
    text = refusal(path)
    assert "/rear/scan" in text
    assert "--scan-topic" in text
    text = refusal(path, scan_topic="/scan")
    assert "/odom, /wheel" in text
    assert "--odom-topic" in text
    assert open_log(path, scan_topic="rear/scan", odom_topic="/wheel").n_scans == 6


def test_topics_that_are_not_there(tmp_path: Path) -> None:
    path = bf.write_bag(tmp_path, scans() + odometry() + mounting())
    assert "no topic /lidar; --scan-topic can be /scan" in refusal(path, scan_topic="/lidar")
    assert "no topic /o; --odom-topic can be /odom, /tf_static" in refusal(path, odom_topic="/o")
    assert "holds nav_msgs/msg/Odometry, not LaserScan" in refusal(path, scan_topic="/odom")
    assert "holds sensor_msgs/msg/LaserScan, not odometry" in refusal(path, odom_topic="/scan")
    assert "in tf" in refusal(path, odom_topic="/tf_static")


@pytest.mark.parametrize("kind", bf.FORMATS)
def test_bag_without_scans(tmp_path: Path, kind: str) -> None:
    text = refusal(bf.write_bag(tmp_path, odometry() + mounting(), kind))
    assert "no LaserScan messages" in text
    assert "/odom" in text


def test_tf_without_odometry(tmp_path: Path) -> None:
    path = bf.write_bag(tmp_path, scans() + mounting())
    assert any("no odometry topic" in x and "in tf" in x for x in open_log(path).warnings)
    assert "in tf" in refusal(path, odom_topic="/tf_static")


def test_scans_that_odometry_does_not_cover_are_left_out(tmp_path: Path) -> None:
    lonely = [bf.scan(T0 - 5.0), bf.scan(T0 - 0.1), bf.scan(T0 + 1.3), bf.scan(T0 + 30.0)]
    log = open_log(bf.write_bag(tmp_path, lonely + scans() + odometry() + mounting()))
    assert len(list(log)) == 8
    assert [x.place for x in log.skipped] == ["message 1 of /scan", "message 10 of /scan"]
    assert "no odometry" in log.skipped[0].reason
    np.testing.assert_allclose(odometry_of(next(iter(log))), np.array(pose_at(T0)), atol=1e-9)


def test_odometry_that_is_not_finite_is_left_out(tmp_path: Path) -> None:
    holed = odometry()
    holed[4] = bf.odometry(ODOMETRY_STAMPS[4], (math.nan, 0.0, 0.0))
    log = open_log(bf.write_bag(tmp_path, scans() + holed + mounting()))
    assert_odometry(log)
    assert "1 of 13 odometry poses are not finite" in log.warnings[0]
    (tmp_path / "log.bag").unlink()
    nothing = [bf.odometry(t, (math.inf, 0.0, 0.0)) for t in ODOMETRY_STAMPS]
    assert "none of the 13 odometry poses is finite" in refusal(bf.write_bag(tmp_path, scans() + nothing))


def test_zero_quaternion_is_no_pose(tmp_path: Path) -> None:
    holed = odometry()
    orientation = holed[4].fields["pose"].fields["pose"].fields["orientation"]
    orientation.fields.update(x=0.0, y=0.0, z=0.0, w=0.0)
    log = open_log(bf.write_bag(tmp_path, scans() + holed + mounting()))
    assert_odometry(log)
    assert "not finite" in log.warnings[0]


BAD_SCANS: dict[str, tuple[dict[str, Any], str]] = {
    "all not a number": ({"ranges": (math.nan,) * 3}, "no beam"),
    "all infinite or negative": ({"ranges": (math.inf, -math.inf, -1.0)}, "no beam"),
    "no beams": ({"ranges": ()}, "at least one beam"),
    "too many beams": ({"ranges": (1.0,) * 6, "angle_max": 0.0}, "6 beams contradict a span"),
    "too few beams": ({"angle_max": 0.8}, "3 beams contradict a span"),
    "angles not finite": ({"angle_min": math.nan}, "contradict"),
    "no step": ({"angle_increment": 0.0}, "contradict"),
    "no limits": ({"range_max": 0.0}, "range_min < range_max"),
}


@pytest.mark.parametrize("case", BAD_SCANS)
def test_a_bad_scan_is_left_out_with_place_and_reason(tmp_path: Path, case: str) -> None:
    changes, reason = BAD_SCANS[case]
    changed = scans()
    changed[2] = bf.scan(SCAN_STAMPS[2], **changes)
    log = open_log(bf.write_bag(tmp_path, changed + odometry() + mounting()))
    for _ in range(2):
        assert [scan.ranges[0] for scan in log] == [1, 2, 4, 5, 6]
        (skipped,) = log.skipped
        assert skipped.place == "message 3 of /scan"
        assert reason in skipped.reason


def test_beam_counts_may_change(tmp_path: Path) -> None:
    changed = scans()
    changed[2] = bf.scan(SCAN_STAMPS[2], (1.0, 2.0, 3.0, 4.0))
    changed[3] = bf.scan(
        SCAN_STAMPS[3], (1.0,) * 4, angle_max=0.5
    )  # the span of a full circle has no end beam
    log = open_log(bf.write_bag(tmp_path, changed + odometry() + mounting()))
    assert [scan.laser.n_beams for scan in log] == [3, 3, 4, 4, 3, 3]
    assert log.skipped == []


def test_a_message_that_cannot_be_decoded(tmp_path: Path) -> None:
    log = open_log(bf.write_bag(tmp_path, scans() + odometry() + mounting(), "mcap"))
    file = next(log.path.glob("*.mcap"))
    data = file.read_bytes()
    start = data.rindex(np.array([6.0, 2.0, np.inf], dtype=np.float32).tobytes()) - 4
    file.write_bytes(data[:start] + b"\xff\xff\xff\x0f" + data[start + 4 :])
    assert len(list(log)) == 5
    assert log.skipped[0].place == "message 6 of /scan"
    assert "cannot be decoded" in log.skipped[0].reason


@pytest.mark.parametrize("stamps", ["zero", "other clock", "standing still"])
def test_header_stamps_that_mislead(tmp_path: Path, stamps: str) -> None:
    """Recording times are used instead: the scans were recorded 0.05 s and the poses 0.002 s after their stamps."""
    changed = scans()
    for i, message in enumerate(changed):
        stamp = {"zero": 0.0, "other clock": T0 - 900.0 + 0.125 * i, "standing still": T0}[stamps]
        message.fields["header"] = bf.header(stamp, "laser")
    log = open_log(bf.write_bag(tmp_path, changed + odometry() + mounting()))
    np.testing.assert_allclose([scan.stamp for scan in log], np.add(SCAN_STAMPS, 0.05), rtol=0, atol=1e-6)
    assert_odometry(log, lambda stamp: pose_at(stamp - 0.002))
    assert "do not share a clock" in log.warnings[0]


def test_headers_of_a_replay_keep_their_clock(tmp_path: Path) -> None:
    """Scans and odometry of one clock that is not the recorder's, as of a replay."""
    late = 5000.0
    messages = [x._replace(bag_stamp=x.bag_stamp + late) for x in scans() + odometry() + mounting()]
    log = open_log(bf.write_bag(tmp_path, messages))
    np.testing.assert_allclose([scan.stamp for scan in log], SCAN_STAMPS, rtol=0, atol=1e-6)
    assert_odometry(log)


def test_file_order_is_kept_and_jumps_are_noted(tmp_path: Path) -> None:
    messages = scans()
    messages[3] = bf.scan(SCAN_STAMPS[0] + 0.01, (4.0, 2.0, 2.0), lag=SCAN_STAMPS[3] - SCAN_STAMPS[0])
    log = open_log(bf.write_bag(tmp_path, messages + odometry() + mounting()))
    assert [scan.ranges[0] for scan in log] == [1, 2, 3, 4, 5, 6]
    assert_odometry(log)
    assert "backward 1 times" in log.warnings[0]


def test_mounting_over_a_chain_with_slashes_and_another_base(tmp_path: Path) -> None:
    chain = [
        bf.transform(T0, "/robot", "/mast", (0.5, 0.0, math.pi / 2), topic="/tf"),
        bf.transform(T0 + 0.5, "mast", "laser", (0.25, 0.0, 0.1), topic="/tf"),
    ]
    log = open_log(bf.write_bag(tmp_path, scans() + odometry(child="/robot") + chain))
    assert next(iter(log)).laser.T_base_laser == pytest.approx((0.5, 0.25, math.pi / 2 + 0.1), abs=2e-6)
    assert log.warnings == []


@pytest.mark.parametrize("child", ["", "unknown_to_tf"])
@pytest.mark.parametrize("base", ["base_link", "base_footprint"])
def test_usual_base_frames(tmp_path: Path, child: str, base: str) -> None:
    fixed = bf.transform(T0, base, "laser", (0.5, -0.25, 0.75))
    log = open_log(bf.write_bag(tmp_path, [*scans(), *odometry(child=child), fixed]))
    assert next(iter(log)).laser.T_base_laser == pytest.approx((0.5, -0.25, 0.75))


def test_unknown_mounting_is_the_identity_and_said(tmp_path: Path) -> None:
    log = open_log(bf.write_bag(tmp_path, scans() + odometry()))
    for _ in range(2):
        assert next(iter(log)).laser.T_base_laser == (0.0, 0.0, 0.0)
        assert log.warnings == [
            "tf does not tell where frame laser sits on base_link;"
            " the laser is taken to sit on the base, unless --laser-pose says where"
        ]


def test_laser_frame_that_is_the_base(tmp_path: Path) -> None:
    log = open_log(bf.write_bag(tmp_path, scans(frame="base_link") + odometry()))
    assert log.warnings == []


@pytest.mark.parametrize("kind", bf.FORMATS)
def test_what_was_used_is_told(tmp_path: Path, kind: str) -> None:
    broadcast = [bf.transform(t, "odom", "base_link", pose_at(t), topic="/tf") for t in ODOMETRY_STAMPS]
    path = bf.write_bag(tmp_path, scans() + odometry() + broadcast + mounting(), kind)
    told = {"scan_topic": "/scan", "laser_pose": (0.5, -0.25, 0.75), "laser_pose_from": "tf"}
    assert source_of(open_log(path)) == {**told, "odom_topic": "/odom"}
    assert source_of(open_log(path, odom_topic="/tf")) == {**told, "odom_topic": "/tf"}


def test_topics_that_were_told_open_the_bag_again(tmp_path: Path) -> None:
    """Odometry by tf, chosen by itself."""
    broadcast = [bf.transform(t, "odom", "base_link", pose_at(t), topic="/tf") for t in ODOMETRY_STAMPS]
    path = bf.write_bag(tmp_path, scans() + broadcast + mounting())
    told = source_of(open_log(path))
    assert told["odom_topic"] == "/tf"
    again = open_log(path, scan_topic=told["scan_topic"], odom_topic=told["odom_topic"])
    assert_same_scans(list(again), list(open_log(path)))


def test_an_assumed_mounting_is_told(tmp_path: Path) -> None:
    told = source_of(open_log(bf.write_bag(tmp_path, scans() + odometry())))
    assert (told["laser_pose"], told["laser_pose_from"]) == ((0.0, 0.0, 0.0), "assumed")


def test_a_given_mounting_takes_the_place_of_tf(tmp_path: Path) -> None:
    bare, full = tmp_path / "bare", tmp_path / "full"
    bare.mkdir()
    full.mkdir()
    messages = scans() + odometry()
    for path in (bf.write_bag(bare, messages), bf.write_bag(full, messages + mounting(roll=math.pi))):
        log = open_log(path, laser_pose=(0.1, 0.2, -3.0))
        assert next(iter(log)).laser.T_base_laser == (0.1, 0.2, -3.0)
        assert log.warnings == []
        assert source_of(log)["laser_pose_from"] == "given"
    laser = next(iter(log)).laser  # tf still tells that it is mounted upside down
    np.testing.assert_allclose(laser.angles_base, -3.0 - np.array([-0.5, -0.25, 0.0]), atol=1e-6)


def test_upside_down_laser_turns_its_beams(tmp_path: Path) -> None:
    log = open_log(bf.write_bag(tmp_path, scans() + odometry() + mounting(roll=math.pi)))
    scan = next(iter(log))
    np.testing.assert_allclose(scan.laser.angles_base, 0.75 - np.array([-0.5, -0.25, 0.0]), atol=1e-6)
    np.testing.assert_array_equal(scan.ranges, [1.0, 2.0, np.inf])
    assert scan.laser.T_base_laser == pytest.approx((0.5, -0.25, 0.75))


def test_tilted_laser_is_said(tmp_path: Path) -> None:
    log = open_log(bf.write_bag(tmp_path, scans() + odometry() + mounting(roll=0.5)))
    assert "tilted by 29 degrees" in log.warnings[0]


@pytest.mark.parametrize("kind", bf.FORMATS)
@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.95])
def test_truncated_bags(tmp_path: Path, kind: str, share: float) -> None:
    many = [bf.scan(T0 + 0.02 * i, tuple(np.linspace(1, 9, 300))) for i in range(60)]
    path = bf.write_bag(tmp_path, many + odometry() + mounting(), kind)
    file = path if kind == "bag" else next(x for x in path.iterdir() if x.suffix != ".yaml")
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    for opened in {path, file}:
        assert "truncated" in refusal(opened)


@pytest.mark.parametrize("kind", ["sqlite3", "mcap"])
def test_damaged_metadata(tmp_path: Path, kind: str) -> None:
    path = bf.write_bag(tmp_path, scans() + odometry(), kind)
    (path / "metadata.yaml").write_text("rosbag2_bagfile_information: [oh")
    assert "damaged" in refusal(path)
    (path / "metadata.yaml").write_text("")
    assert "damaged" in refusal(path)


@pytest.mark.parametrize("kind", ["sqlite3", "mcap"])
@pytest.mark.parametrize(("key", "value"), [("nanoseconds", "soon"), ("nanoseconds_since_epoch", "null")])
def test_numbers_of_the_metadata_that_are_none(tmp_path: Path, kind: str, key: str, value: Any) -> None:
    path = bf.write_bag(tmp_path, scans() + odometry() + mounting(), kind)
    text = (path / "metadata.yaml").read_text()
    damaged = re.sub(rf"({key}): \d+", rf"\1: {value}", text)
    assert damaged != text
    (path / "metadata.yaml").write_text(damaged)
    assert "damaged" in refusal(path)


def test_bag_file_that_is_missing(tmp_path: Path) -> None:
    path = bf.write_bag(tmp_path, scans() + odometry(), "mcap")
    next(path.glob("*.mcap")).unlink()
    assert "missing" in refusal(path)
    (path / "metadata.yaml").unlink()
    assert "no ROS 2 bag" in refusal(path)


def test_several_files_without_metadata(tmp_path: Path) -> None:
    path = bf.write_bag(tmp_path, scans() + odometry(), "mcap")
    shutil.copy(next(path.glob("*.mcap")), path / "more.mcap")
    (path / "metadata.yaml").unlink()
    assert "ros2 bag reindex" in refusal(path)


def test_damage_in_the_middle_is_told_when_it_is_met(tmp_path: Path) -> None:
    many = [bf.scan(T0 + 0.02 * i, tuple(np.linspace(1, 9, 30))) for i in range(60)]
    log = open_log(bf.write_bag(tmp_path, many + odometry() + mounting()))
    data = bytearray(log.path.read_bytes())
    middle = data.index(b"op=\x02", len(data) // 3)
    data[middle : middle + 400] = bytes(400)
    log.path.write_bytes(data)
    with pytest.raises(InputError, match="damaged"):
        list(log)
