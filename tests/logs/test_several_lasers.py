"""Several lasers of a bag, on one topic or on several: their order, numbers and mountings."""

import math
from pathlib import Path

import numpy as np
import pytest

from slammot_graph.core.errors import ConfigError, InputError
from slammot_graph.logs import open_log, source_of, write_npz_log
from slammot_graph.logs.bag_scans import order_of_scans
from slammot_graph.logs.mounting import given_poses
from tests.logs import bag_files as bf

T0 = 1_600_000_000.0
FRONT, REAR = (0.5, -0.25, 0.0), (-0.5, 0.1, math.pi)


def two(tmp_path: Path, *, topics: tuple[str, str] = ("/front", "/rear"), has_tf: bool = True) -> Path:
    """Front and rear scans; those of the rear are recorded after the front's next ones."""
    sent = []
    for k in range(6):
        sent.append(bf.scan(T0 + 0.1 * k, (1.0 + k, 2.0, 3.0), frame="front", topic=topics[0]))
        sent.append(bf.scan(T0 + 0.1 * k + 0.03, (11.0 + k, 2.0, 3.0), frame="rear", topic=topics[1]))
    odometry = [bf.odometry(T0 + 0.05 * k, (0.1 * k, 0.0, 0.0)) for k in range(-2, 14)]
    tf = [bf.transform(T0, "base_link", "front", FRONT), bf.transform(T0, "base_link", "rear", REAR)]
    return bf.write_bag(tmp_path, [*sent, *odometry, *(tf if has_tf else [])])


@pytest.mark.parametrize("topics", [("/front", "/rear"), ("/scan", "/scan")])
def test_each_scan_has_its_laser_and_the_order_is_that_of_the_stamps(
    tmp_path: Path, topics: tuple[str, str]
) -> None:
    log = open_log(two(tmp_path, topics=topics), scan_topic=sorted(set(topics)))
    scans = list(log)
    assert [scan.ranges[0] for scan in scans] == [x for k in range(6) for x in (1.0 + k, 11.0 + k)]
    assert (np.diff([scan.stamp for scan in scans]) > 0.0).all()
    assert [scan.laser.number for scan in scans] == [0, 1] * 6
    assert scans[0].laser.T_base_laser == pytest.approx(FRONT)
    assert scans[1].laser.T_base_laser == pytest.approx(REAR, abs=1e-5)
    lasers = source_of(log)["lasers"]
    assert [x["frame"] for x in lasers] == ["front", "rear"]
    assert [x["n_scans"] for x in lasers] == [6, 6]


def test_several_topics_must_be_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"several LaserScan topics .*or all that are the robot's lasers"):
        open_log(two(tmp_path))


def test_each_laser_may_be_placed_by_hand(tmp_path: Path) -> None:
    path = two(tmp_path, topics=("/scan", "/scan"), has_tf=False)
    words = ("front", 0.5, -0.25, 0.0, "/rear", -0.5, 0.1, 3.0, "flip")
    scans = list(open_log(path, laser_pose=words))
    assert scans[0].laser.T_base_laser == (0.5, -0.25, 0.0)
    assert scans[0].laser.angle_increment > 0.0
    assert scans[1].laser.T_base_laser == (-0.5, 0.1, 3.0)
    assert scans[1].laser.angle_increment == pytest.approx(-scans[0].laser.angle_increment)
    assert scans[1].laser.angle_min == pytest.approx(-scans[0].laser.angle_min)
    with pytest.raises(InputError, match="names the frame back, but the frames of the scans are front, rear"):
        open_log(path, laser_pose=("back", 0.0, 0.0, 0.0))


def test_order_of_scans() -> None:
    stamps = np.array([0.0, 0.2, 0.1, np.nan, 0.3, 0.15])
    laser = np.array([0, 0, 1, -1, 0, 1])
    assert order_of_scans(stamps, laser).tolist() == [0, 2, 5, 1, 3, 4]
    backward = np.array([0.0, 0.2, 0.1])
    assert order_of_scans(backward, np.zeros(3, dtype=np.int64)).tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    "words", [(1.0, 2.0), (1.0, 2.0, math.inf), ("flip", 0, 0, 0), (0, 0, 0, 1), ("a", 1, "b")]
)
def test_what_is_no_laser_pose(words: tuple[float | str, ...]) -> None:
    with pytest.raises(ConfigError, match="three finite numbers X Y YAW"):
        given_poses(words)


def test_a_flipped_laser_of_arrays(tmp_path: Path) -> None:
    ranges = np.ones((4, 5))
    write_npz_log(
        tmp_path / "log.npz",
        stamps=0.1 * np.arange(4),
        ranges=ranges,
        angle_min=-1.0,
        angle_increment=0.25,
        range_min=0.1,
        range_max=9.0,
    )
    log = open_log(tmp_path / "log.npz", laser_pose=(0.1, 0.0, 1.0, "flip"))
    laser = next(iter(log)).laser
    assert (laser.angle_min, laser.angle_increment, laser.T_base_laser) == (1.0, -0.25, (0.1, 0.0, 1.0))
    assert source_of(log)["given_laser_pose"] == ["0.1", "0.0", "1.0", "flip"]
    assert any("no odometry" in x for x in log.warnings)
    with pytest.raises(InputError, match="its laser has no frame"):
        open_log(tmp_path / "log.npz", laser_pose=("front", 0.1, 0.0, 1.0))
