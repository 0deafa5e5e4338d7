"""The readers on the recorded logs."""

from pathlib import Path

import numpy as np
import pytest

from slammot_graph.core.errors import InputError
from slammot_graph.logs import open_log
from tests.logs.compare import assert_same_scans
from tests.rooms import odometry_of

pytestmark = pytest.mark.real


def test_intel(recorded_data: Path) -> None:
    log = open_log(recorded_data / "freiburg" / "intel.clf.bz2")
    scans = list(log)
    assert log.n_scans == len(scans) == 13_631
    assert {scan.laser for scan in scans} == {scans[0].laser}
    assert (scans[0].laser.n_beams, scans[0].laser.T_base_laser) == (180, (0.0, 0.0, 0.0))
    assert scans[0].laser.range_max == pytest.approx(81.87, abs=0.05)
    steps_s = np.diff([scan.stamp for scan in scans])
    assert np.count_nonzero(steps_s < 0.0) == 631  # the file's order is kept
    assert steps_s.min() == pytest.approx(-0.9, abs=0.05)
    steps = np.diff([odometry_of(scan)[:2] for scan in scans], axis=0)
    assert np.linalg.norm(steps, axis=1).sum() == pytest.approx(508.0, abs=1.0)
    assert log.skipped == []
    assert any("backward 631 times" in x for x in log.warnings)


def test_aces(recorded_data: Path) -> None:
    log = open_log(recorded_data / "freiburg" / "aces.clf.bz2")
    scans = list(log)
    assert log.n_scans == len(scans) == 7_374
    assert {scan.laser for scan in scans} == {scans[0].laser}
    assert (scans[0].laser.n_beams, scans[0].laser.range_max) == (180, 50.0)
    assert (log.warnings, log.skipped) == ([], [])


def test_robotlaser_log(recorded_data: Path) -> None:
    log = open_log(recorded_data / "freiburg" / "fr-clinic_robotlaser.clf.bz2")
    scans = list(log)
    assert log.n_scans == len(scans) == 6_917
    assert {scan.laser.n_beams for scan in scans} == {180, 181}
    assert len({id(scan.laser) for scan in scans}) == 4
    assert {scan.laser.T_base_laser for scan in scans} == {(0.22, 0.0, 0.0)}
    assert {scan.laser.range_max for scan in scans} == {81.9}


def test_general_tracking_and_its_twin(recorded_data: Path) -> None:
    folder = recorded_data / "bags"
    ros1 = open_log(folder / "general_tracking_moving_1.bag")
    scans = list(ros1)
    assert ros1.n_scans == len(scans) == 873
    assert (scans[0].laser.n_beams, scans[0].laser.range_max) == (768, 11.0)
    assert scans[0].laser.T_base_laser == pytest.approx((0.85, 0.235, 0.735), abs=1e-3)
    assert (ros1.warnings, ros1.skipped) == ([], [])
    twin = folder / "general_tracking_moving_1_mcap"
    assert_same_scans(list(open_log(twin)), scans)
    assert_same_scans(list(open_log(twin / "general_tracking_moving_1_mcap.mcap")), scans)


def test_overtakes_and_its_twin(recorded_data: Path) -> None:
    folder = recorded_data / "bags" / "overtakes_sqlite3"
    with pytest.raises(InputError, match=r"/ego_pose, /red_pose.*--odom-topic"):
        open_log(folder)
    log = open_log(folder, odom_topic="/ego_pose")
    scans = list(log)
    assert log.n_scans == len(scans) == 339
    assert scans[0].laser.n_beams == 360
    assert "laser is taken to sit on the base" in log.warnings[0]
    assert_same_scans(list(open_log(folder / "overtakes_sqlite3.db3", odom_topic="/ego_pose")), scans)
    ros1 = open_log(recorded_data / "datmo" / "overtakes.bag", odom_topic="/ego_pose")
    assert_same_scans(list(ros1), scans)


def test_parallel(recorded_data: Path) -> None:
    log = open_log(recorded_data / "datmo" / "parallel.bag", odom_topic="/ego_pose")
    assert len(list(log)) == log.n_scans == 219
    assert log.warnings[0].startswith("tf does not tell")
