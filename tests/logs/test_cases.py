"""Small logs that went wrong once: what the readers make of their odometry, stamps and frames."""

import re
from pathlib import Path

import numpy as np
import pytest

from slammot_graph.core.config import load_config
from slammot_graph.core.errors import ConfigError, InputError
from slammot_graph.evaluation import absolute_error
from slammot_graph.logs import open_log
from slammot_graph.methods import get_method
from slammot_graph.run import Run
from slammot_graph.run_folder.reader import read_run_folder

pytestmark = pytest.mark.cases


def test_a_bag_of_scans_alone(cases: Path) -> None:
    result = Run(open_log(cases / "laser_only.bag")).complete()
    u = 2.0 * np.pi * np.arange(120) / 119.0
    truth = np.column_stack([-1.5 + 0.96 * np.sin(u), -0.6 + 0.5 * (1.0 - np.cos(u)), np.zeros(120)])
    assert absolute_error(result.T_map_base, truth).translation_m.rmse < 0.01


@pytest.mark.parametrize("name", ["wheels_spin.npz", "odometry_factor2.npz", "contradiction_yaw_sign.npz"])
def test_odometry_off(cases: Path, name: str) -> None:
    result = Run(open_log(cases / name, odometry=False)).complete()
    assert result.T_world_base is not None
    assert absolute_error(result.T_map_base, result.T_world_base).translation_m.rmse < 0.01


def test_odometry_that_is_a_static_transform(cases: Path) -> None:
    log = open_log(cases / "static_tf_odometry")
    result = Run(log).complete()
    assert len(result.stamps) == 393
    assert result.n_failed_matches == 0
    assert any("static transform" in x and "the laser alone" in x for x in log.warnings)


def test_an_odometry_pose_out_of_any_sense(cases: Path) -> None:
    log = open_log(cases / "odo_one_1e308.npz")
    assert len(Run(log).complete().stamps) == 59
    assert [x.place for x in log.skipped] == ["row 30"]


def test_two_lasers_on_one_topic(cases: Path) -> None:
    log = open_log(cases / "two_lasers_one_topic")
    result = Run(log).complete()
    with np.load(cases / "odometry_factor2.npz") as file:  # the same drive
        truth = file["poses"]
    for first in (0, 1):
        assert absolute_error(result.T_map_base[first::2], truth[:393]).translation_m.rmse < 0.005
    assert any("two frames (lasers) on one topic" in x for x in log.warnings)


@pytest.mark.parametrize(("name", "words"), [("zero", "all stamps are the same"), ("wrapped", r"2\^32 s")])
def test_stamps_that_are_no_time(cases: Path, name: str, words: str) -> None:
    log = open_log(cases / f"{name}_stamps.log")
    np.testing.assert_allclose(np.diff([scan.stamp for scan in log]), 0.1, atol=1e-5)
    assert any(re.search(words, x) for x in log.warnings)
    assert any("scan numbers serve as time, at 10 scans a second (assumed)" in x for x in log.warnings)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("record_v12.bag", r"version 1\.2.*rosbag fix"),
        ("sqlite_text_timestamp.db3", "damaged"),
        ("bomb_oneline.clf.bz2", "line 1 is longer"),
    ],
)
def test_what_is_no_log_is_told(cases: Path, name: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        open_log(cases / name)
    assert str(cases / name) in str(caught.value)


def test_a_bag_of_2010_whose_index_tells_another_length(cases: Path) -> None:
    old, twin = (
        list(open_log(cases / name)) for name in ("old_index_length.bag", "forwards_laser_no_tf.bag")
    )
    assert len(old) == len(twin) == 120
    for a, b in zip(old, twin, strict=True):
        assert a.stamp == b.stamp
        np.testing.assert_array_equal(a.ranges, b.ranges)
        np.testing.assert_array_equal(a.T_odom_base, b.T_odom_base)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("record_v12.bag", r"a bag of version 1\.2, which is not read; convert it with `rosbag fix`"),
        ("sqlite_text_timestamp.db3", "damaged"),
        ("bomb_oneline.clf.bz2", "is longer than"),
    ],
)
def test_what_cannot_be_read_is_told_in_a_line(cases: Path, name: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        list(open_log(cases / name))
    assert "\n" not in str(caught.value)
    assert name in str(caught.value)


@pytest.mark.parametrize(
    ("name", "file"), [("folder_tum_1e308", "trajectory.tum, line 6"), ("folder_map_origin_nan2", "map.yaml")]
)
def test_damaged_run_folders(cases: Path, name: str, file: str) -> None:
    with pytest.raises(InputError, match=f"{name}/{file}"):
        read_run_folder(cases / name)


@pytest.mark.parametrize(
    ("name", "key"), [("inf", "max_range_m"), ("res", "grid"), ("maxrange1e6", "max_range_m")]
)
def test_settings_out_of_any_sense(cases: Path, name: str, key: str) -> None:
    with pytest.raises(ConfigError, match=rf"cfg_{name}\.toml: {key}[a-z_.]* must be"):
        load_config(cases / f"cfg_{name}.toml", get_method("graph").config)


@pytest.mark.parametrize("name", ["standing_robot.npz", "stands_still_map.npz"])
def test_the_map_of_a_robot_that_stands(cases: Path, name: str) -> None:
    p = Run(open_log(cases / name)).complete().grid.p_occupied
    assert np.count_nonzero(p > 0.8) > 200
    assert np.count_nonzero(p < 0.2) > 5000


def test_the_path_through_a_hall_beyond_the_lasers_reach_is_free(cases: Path) -> None:
    result = Run(open_log(cases / "short_range_hall.npz")).complete()
    j, i = np.floor((result.T_map_base[:, :2] - result.grid.origin) / result.grid.resolution_m).astype(int).T
    assert (result.grid.p_occupied[i, j] < 0.2).all()
