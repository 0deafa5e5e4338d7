"""How a laser is turned on the base, found from the drive."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.diagnosis.checking import check_log
from slammot_graph.diagnosis.mounting import find_turn, with_found_mounting
from slammot_graph.logs import open_log, source_of
from slammot_graph.run import Run
from tests.logs import bag_files as bf

ANGLES = {"angle_min": -math.pi / 2, "angle_max": math.pi / 2, "angle_increment": math.pi / 180}
MIRROR = np.array([1.0, -1.0, -1.0])


def driven(n: int = 200) -> FloatArray:
    """Odometry (n, 3) along a winding way."""
    steps = np.column_stack([np.full(n, 0.05), np.zeros(n), 0.06 * np.sin(0.1 * np.arange(n))])
    poses = [np.zeros(3)]
    for step in steps[:-1]:
        poses.append(se2.compose(poses[-1], step))
    return np.array(poses)


@pytest.mark.parametrize("yaw", [0.0, math.pi, 2.0, -0.6])
@pytest.mark.parametrize("is_upside_down", [False, True])
def test_the_turn_of_a_laser_off_the_centre(yaw: float, is_upside_down: bool) -> None:
    T_odom = driven()
    X = np.array([0.3, -0.1, yaw])
    T_laser = se2.compose(se2.compose(se2.inverse(X)[None], T_odom), X[None])
    T_laser = T_laser * MIRROR if is_upside_down else T_laser
    rng = np.random.default_rng(4)
    T_laser[:, :2] += 0.005 * rng.standard_normal((len(T_laser), 2))
    found = find_turn(T_laser, T_odom)
    assert found is not None
    assert found.is_upside_down is is_upside_down
    assert abs(se2.wrap_angle(found.yaw_rad - yaw)) < max(4.0 * found.yaw_std_rad, 0.01)
    assert found.yaw_std_rad < 0.03


def test_a_robot_that_stands_tells_nothing() -> None:
    assert find_turn(np.zeros((50, 3)), np.zeros((50, 3))) is None


def test_turns_that_do_not_go_together_tell_nothing() -> None:
    T_odom = driven()
    T_laser = T_odom.copy()
    T_laser[:, 2] = np.random.default_rng(1).normal(size=len(T_odom))
    assert find_turn(T_laser, T_odom) is None


def bag(tmp_path: Path, yaw: float, *, is_upside_down: bool) -> Path:
    """A drive around a room, 181 beams; nothing tells of the mounting."""
    T = driven(150) + np.array([-2.0, 0.3, 0.0])
    angles = np.radians(np.arange(-90.0, 91.0))
    sent = []
    for k, pose in enumerate(T):
        t = 1000.0 + 0.1 * k
        beams = pose[2] + yaw + (-angles if is_upside_down else angles)
        sent.append(bf.scan(t, room(pose, beams), **dict[str, Any](ANGLES)))
        sent.append(bf.odometry(t, se2.between(T[0], pose).tolist()))
    return bf.write_bag(tmp_path, sent)


def room(pose: FloatArray, beams: FloatArray) -> list[float]:
    """Ranges in a room of 14 x 6 m with a box in a corner."""
    c, s = np.cos(beams), np.sin(beams)
    with np.errstate(divide="ignore", invalid="ignore"):
        to_x = np.where(c > 0.0, (9.0 - pose[0]) / c, (-5.0 - pose[0]) / c)
        to_y = np.where(s > 0.0, (3.0 - pose[1]) / s, (-3.0 - pose[1]) / s)
        box_x = (7.0 - pose[0]) / c
        y = pose[1] + box_x * s
        to_box = np.where((c > 0.0) & (y > 1.0) & (y < 3.0) & (box_x > 0.0), box_x, np.inf)
    return [float(x) for x in np.minimum(np.minimum(to_x, to_y), to_box)]


@pytest.mark.parametrize(("yaw", "is_upside_down"), [(math.pi, False), (0.0, True), (math.pi, True)])
def test_a_bag_without_tf_as_its_twin(tmp_path: Path, yaw: float, is_upside_down: bool) -> None:
    (tmp_path / "twin").mkdir()
    log = open_log(bag(tmp_path, yaw, is_upside_down=is_upside_down))
    run = Run(log)
    result = run.complete()
    twin = Run(open_log(bag(tmp_path / "twin", 0.0, is_upside_down=False))).complete()
    np.testing.assert_allclose(result.T_map_base[:, :2], twin.T_map_base[:, :2], atol=0.03)
    (told,) = [x for x in result.log.warnings if "mounted" in x]
    assert ("upside down" in told) is is_upside_down
    assert ("turned by" in told) is (yaw != 0.0)
    assert not any("taken to sit on the base" in x for x in result.log.warnings)
    words = source_of(run.log)["given_laser_pose"]
    again = next(iter(open_log(log.path, laser_pose=words))).laser
    assert again == next(iter(run.log)).laser


def test_other_logs_stay_as_they_are(tmp_path: Path) -> None:
    log = open_log(bag(tmp_path, 0.0, is_upside_down=False))
    assert with_found_mounting(log) is log
    placed = open_log(log.path, laser_pose=(0.0, 0.0, math.pi))
    assert with_found_mounting(placed) is placed
    alone = open_log(log.path, odometry=False)
    assert with_found_mounting(alone) is alone


def test_check_looks_at_a_log_as_a_run_uses_it(tmp_path: Path) -> None:
    report = check_log(open_log(bag(tmp_path, math.pi, is_upside_down=True)))
    assert report.health.get("healthy", 0) > 0.9 * report.n_matched_scans
    assert report.log.source["laser_pose_from"] == "the drive"
    assert any("upside down" in x for x in report.log.warnings)
