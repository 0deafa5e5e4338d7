"""What of a bag tells of the motion, and of which laser: tf frames, an IMU, nothing at all, two lasers on one topic."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slammot_graph.core.errors import InputError
from slammot_graph.logs import open_log, source_of
from slammot_graph.logs.bag_imu import YawTrack
from tests.logs import bag_files as bf
from tests.logs.compare import assert_same_scans
from tests.rooms import odometry_of

T0 = 1_600_000_000.0
STAMPS = [T0 + 0.125 * i for i in range(1, 9)]
TIMES = [T0 + 0.1 * i for i in range(13)]
ALONE = "the laser alone tells of the motion"


def scans(**changes: Any) -> list[bf.Sent]:
    return [bf.scan(t, (1.0 + i, 2.0, 3.0), **changes) for i, t in enumerate(STAMPS)]


def moving(parent: str, child: str, speed: float = 1.0, topic: str = "/tf") -> list[bf.Sent]:
    return [bf.transform(t, parent, child, (speed * (t - T0), 0.0, 0.0), topic=topic) for t in TIMES]


def mounted(base: str = "base_link", laser: str = "laser") -> bf.Sent:
    return bf.transform(T0, base, laser, (0.5, -0.25, 0.75))


@pytest.mark.parametrize("kind", bf.FORMATS)
def test_a_bag_of_scans_alone(tmp_path: Path, kind: str) -> None:
    log = open_log(bf.write_bag(tmp_path, scans(), kind))
    found = list(log)
    assert [scan.ranges[0] for scan in found] == list(range(1, 9))
    np.testing.assert_allclose([scan.stamp for scan in found], STAMPS, rtol=0, atol=1e-6)
    assert all(scan.T_odom_base is None and scan.odometry is None and scan.imu_yaw is None for scan in found)
    assert log.skipped == []
    assert any("no odometry" in x and ALONE in x for x in log.warnings)
    assert source_of(log)["odometry"] == "none"
    assert "odom_topic" not in source_of(log)


@pytest.mark.parametrize("topic", ["/tf_static", "/tf"])
def test_a_static_transform_is_no_odometry(tmp_path: Path, topic: str) -> None:
    times = TIMES[:1] if topic == "/tf_static" else TIMES
    fixed = [bf.transform(t, "odom", "base_link", (0.0, 0.0, 0.0), topic=topic) for t in times]
    log = open_log(bf.write_bag(tmp_path, [*scans(), *fixed, mounted()]))
    found = list(log)
    assert len(found) == 8
    assert {scan.T_odom_base for scan in found} == {None}
    assert found[0].laser.T_base_laser == pytest.approx((0.5, -0.25, 0.75))
    assert log.warnings == [f"odometry in tf is a static transform of base_link, which never moves: {ALONE}"]


def test_odometry_may_be_left_aside(tmp_path: Path) -> None:
    several = [bf.odometry(t, (9, 9, 9), topic=topic) for t in TIMES for topic in ("/a", "/b")]
    path = bf.write_bag(tmp_path, [*scans(), *several, mounted()])
    with pytest.raises(InputError, match="several odometry topics"):
        open_log(path)
    log = open_log(path, odometry=False)
    assert all(scan.T_odom_base is None for scan in log)
    assert log.warnings == []
    assert source_of(log)["odometry"] == "off"
    assert next(iter(log)).laser.T_base_laser == pytest.approx((0.5, -0.25, 0.75))


def test_the_whole_odometry_is_there_from_the_first_scan(tmp_path: Path) -> None:
    path = bf.write_bag(tmp_path, [*scans(), *[bf.odometry(t, (t - T0, 0, 0)) for t in TIMES], mounted()])
    found = list(open_log(path))
    track = found[0].odometry
    assert track is not None
    assert all(scan.odometry is track for scan in found)
    np.testing.assert_allclose(track.at_many(np.array([T0 + 1.15])), [[1.15, 0.0, 0.0]], atol=1e-5)


def test_odometry_that_stops(tmp_path: Path) -> None:
    late = [bf.scan(T0 + 2.0 + 0.125 * i) for i in range(10)]
    log = open_log(bf.write_bag(tmp_path, [*scans(), *late, *moving("odom", "base_link"), mounted()]))
    found = list(log)
    assert [scan.T_odom_base is None for scan in found] == [False] * 8 + [True] * 10
    assert "10 of 18 scans have no odometry" in log.warnings[0]


@pytest.mark.parametrize("named", [False, True])
def test_frames_with_a_robots_name(tmp_path: Path, named: bool) -> None:
    messages = [*scans(frame="robot1/laser"), *moving("robot1/odom", "robot1/base_link")]
    path = bf.write_bag(tmp_path, [*messages, mounted("robot1/base_link", "robot1/laser")])
    frames = {"odom_frame": "/robot1/odom", "base_frame": "robot1/base_link"} if named else {}
    log = open_log(path, **frames)  # type: ignore[arg-type]
    for scan in log:
        np.testing.assert_allclose(odometry_of(scan), [scan.stamp - T0, 0.0, 0.0], atol=1e-5)
        assert scan.laser.T_base_laser == pytest.approx((0.5, -0.25, 0.75))
    assert log.warnings == []
    assert {key: source_of(log).get(key) for key in frames} == frames


def test_frames_of_other_names_have_to_be_given(tmp_path: Path) -> None:
    path = bf.write_bag(tmp_path, [*scans(), *moving("wheels", "chassis"), mounted("chassis")])
    assert any("no odometry topic" in x and ALONE in x for x in open_log(path).warnings)
    for frames in ({"odom_frame": "wheels"}, {"odom_frame": "wheels", "base_frame": "chassis"}):
        log = open_log(path, **frames)  # type: ignore[arg-type]
        assert odometry_of(next(iter(log)))[0] == pytest.approx(0.125)
        assert next(iter(log)).laser.T_base_laser == pytest.approx((0.5, -0.25, 0.75))
    with pytest.raises(InputError, match=r"no base_link or .* in whels in tf.*--odom-frame"):
        open_log(path, odom_frame="whels")


def test_two_robots_have_to_be_chosen_from(tmp_path: Path) -> None:
    both = [*moving("a/odom", "a/base_link"), *moving("b/odom", "b/base_link", 2.0)]
    path = bf.write_bag(tmp_path, [*scans(), *both])
    with pytest.raises(InputError, match=r"several robots \(a/base_link in a/odom, b/base_link in b/odom\)"):
        open_log(path)
    assert odometry_of(next(iter(open_log(path, odom_frame="b/odom"))))[0] == pytest.approx(0.25)


def test_only_bags_have_frames_and_an_imu(tmp_path: Path) -> None:
    path = tmp_path / "a.clf"
    path.write_text("FLASER 1 1.0 0 0 0 0 0 0 1.0 h 1.0\n")
    with pytest.raises(InputError, match="no frames"):
        open_log(path, odom_frame="odom")
    with pytest.raises(InputError, match="no topics"):
        open_log(path, imu_topic="/imu")


def imu(
    stamp: float, rate: tuple[float, float, float], *, topic: str = "/imu", frame: str = "imu"
) -> bf.Sent:
    axes = zip("xyz", rate, strict=True)
    fields = {
        "header": bf.header(stamp, frame),
        "orientation": bf.quaternion(0.0),
        "orientation_covariance": np.zeros(9),
        "angular_velocity": bf.Part("geometry_msgs/msg/Vector3", dict(axes)),
        "angular_velocity_covariance": np.zeros(9),
        "linear_acceleration": bf.Part("geometry_msgs/msg/Vector3", {"x": 0.0, "y": 0.0, "z": 9.8}),
        "linear_acceleration_covariance": np.zeros(9),
    }
    return bf.Sent(topic, stamp + 0.001, "sensor_msgs/msg/Imu", fields)


@pytest.mark.parametrize("kind", bf.FORMATS)
def test_yaw_of_an_imu(tmp_path: Path, kind: str) -> None:
    turning = [imu(T0 + 0.01 * i, (0.0, 0.0, 2.0)) for i in range(130)]
    log = open_log(bf.write_bag(tmp_path, [*scans(), *turning], kind))
    yaw = [scan.imu_yaw for scan in log]
    assert None not in yaw
    np.testing.assert_allclose(np.diff(np.array(yaw, dtype=float)), 0.25, atol=1e-5)
    assert source_of(log)["imu_topic"] == "/imu"


def test_an_imu_upside_down_turns_the_other_way(tmp_path: Path) -> None:
    turning = [imu(T0 + 0.01 * i, (0.0, 0.0, 2.0)) for i in range(130)]
    flipped = bf.transform(T0, "base_link", "imu", (0.0, 0.0, 0.3), roll=math.pi)
    yaw = [scan.imu_yaw for scan in open_log(bf.write_bag(tmp_path, [*scans(), *turning, flipped]))]
    np.testing.assert_allclose(np.diff(np.array(yaw, dtype=float)), -0.25, atol=1e-5)


def test_several_imus(tmp_path: Path) -> None:
    turning = [imu(T0 + 0.01 * i, (0.0, 0.0, 2.0), topic=x) for i in range(130) for x in ("/front", "/rear")]
    path = bf.write_bag(tmp_path, [*scans(), *turning])
    log = open_log(path)
    assert next(iter(log)).imu_yaw is None
    assert any("several Imu topics (/front, /rear), none is used" in x for x in log.warnings)
    assert next(iter(open_log(path, imu_topic="/rear"))).imu_yaw is not None
    with pytest.raises(InputError, match="no topic /other; --imu-topic can be /front, /rear"):
        open_log(path, imu_topic="/other")


def test_yaw_leaves_out_what_is_not_finite_and_is_not_told_in_gaps() -> None:
    stamps = np.array([0.0, 0.1, 0.2, 0.3, 2.0, 2.1])
    track = YawTrack.from_rates(stamps, np.array([1.0, np.nan, 1.0, 1.0, 1.0, np.inf]))
    assert track.at(0.1) == pytest.approx(0.1)
    assert track.at(0.25) == pytest.approx(0.25)
    assert track.at(1.0) is None
    assert track.at(2.05) == pytest.approx(2.0)
    assert (track.at(-1.0), track.at(3.0)) == (None, None)
    assert YawTrack.from_rates(np.empty(0), np.empty(0)).at(0.0) is None


def two_lasers() -> list[bf.Sent]:
    front, rear = scans(frame="front"), [bf.scan(t + 0.01, (9.0, 9.0, 9.0), frame="rear") for t in STAMPS]
    wheels = [bf.odometry(t, (t - T0, 0, 0)) for t in TIMES]
    return [*front, *rear, *wheels, bf.transform(T0, "base_link", "front", (0.3, 0.0, 0.0))]


def test_two_lasers_on_one_topic_each_by_its_frame(tmp_path: Path) -> None:
    behind = bf.transform(T0, "base_link", "rear", (-0.3, 0.0, math.pi), roll=math.pi)
    log = open_log(bf.write_bag(tmp_path, [*two_lasers(), behind]))
    found = list(log)
    assert len(found) == 16
    front, rear = found[0].laser, found[1].laser
    assert front.T_base_laser == pytest.approx((0.3, 0.0, 0.0))
    assert rear.T_base_laser == pytest.approx((-0.3, 0.0, math.pi))
    assert (front.angle_increment, rear.angle_increment) == (0.25, -0.25)
    assert all(scan.laser is (front if k % 2 == 0 else rear) for k, scan in enumerate(found))
    assert log.warnings == [
        "two frames (lasers) on one topic /scan (scans: front 8, rear 8);"
        " each scan is used by its own frame's place on the robot"
    ]
    assert_same_scans(list(log), found)


@pytest.mark.parametrize("given", [False, True])
def test_a_laser_whose_place_is_not_known_is_left_out(tmp_path: Path, given: bool) -> None:
    log = open_log(bf.write_bag(tmp_path, two_lasers()), laser_pose=(1.0, 0.0, 0.0) if given else None)
    found = list(log)
    assert [scan.ranges[0] for scan in found] == list(range(1, 9))
    assert found[0].laser.T_base_laser == pytest.approx((1.0 if given else 0.3, 0.0, 0.0))
    assert len(log.skipped) == 8
    assert "where frame rear sits" in log.skipped[0].reason
    assert "two frames (lasers) on one topic" in log.warnings[0]
    assert "only scans of front are used" in log.warnings[0]


def test_headers_that_stand_still_without_odometry(tmp_path: Path) -> None:
    messages = scans()
    for message in messages:
        message.fields["header"] = bf.header(5.0, "laser")
    log = open_log(bf.write_bag(tmp_path, messages))
    np.testing.assert_allclose([scan.stamp for scan in log], np.add(STAMPS, 0.05), rtol=0, atol=1e-6)
    assert any("do not rise; recording times are used" in x for x in log.warnings)


def test_a_bag_of_2008(tmp_path: Path) -> None:
    path = tmp_path / "old.bag"
    path.write_bytes(b"#ROSRECORD V1.2\n" + bytes(100))
    with pytest.raises(InputError, match=r"old\.bag: a bag of version 1\.2.*rosbag fix"):
        open_log(path)


@pytest.mark.parametrize("x_m", [np.nan, 120.0, 1e200])
def test_a_transform_out_of_any_sense_is_not_used(tmp_path: Path, x_m: float) -> None:
    placed = bf.transform(T0, "base_link", "laser", (x_m, 0.0, 0.0))
    log = open_log(bf.write_bag(tmp_path, [*scans(), *moving("odom", "base_link"), placed]))
    assert [x.laser.T_base_laser for x in log] == [(0.0, 0.0, 0.0)] * len(STAMPS)
    assert any("the laser is taken to sit on the base" in x for x in log.warnings)
