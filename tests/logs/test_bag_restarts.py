"""A simulation that was restarted while it was recorded: two runs in one bag, one after the other."""

from pathlib import Path

import numpy as np
import pytest

from slammot_graph.logs import open_log
from slammot_graph.logs.bag_restarts import restarts
from tests.logs import bag_files as bf
from tests.rooms import odometry_of

WALL = 1_600_000_000.0
N = 60


def restarted(*, odometry: bool = True, restarts_odometry: bool = True) -> list[bf.Sent]:
    """Two runs of 6 s by a clock that begins at 10 s; the first drives along x, the second along y, at 1 m/s."""
    sent = []
    for run in range(2):
        for k in range(N):
            wall, sim = WALL + 8.0 * run + 0.1 * k, 10.0 + 0.1 * k
            sent.append(bf.scan(sim, (1.0 + run, 2.0, 3.0), lag=wall - sim))
            if odometry:
                stamp = sim if restarts_odometry else wall - WALL + 10.0
                pose = (0.1 * k, 0.0, 0.0) if run == 0 else (0.0, 0.1 * k, 1.0)
                sent.append(bf.odometry(stamp, pose, lag=wall - stamp))
    return sent


@pytest.mark.parametrize("suffix", bf.FORMATS)
def test_two_runs_follow_each_other(tmp_path: Path, suffix: str) -> None:
    log = open_log(bf.write_bag(tmp_path, restarted(), suffix))
    assert any("begins again once, first at scan 60, by up to 5.9 s" in text for text in log.warnings)
    scans = list(log)
    assert len(scans) == 2 * N
    assert (np.diff([scan.stamp for scan in scans]) > 0.0).all()
    poses = np.array([odometry_of(scan) for scan in scans])
    np.testing.assert_allclose(poses[:N, 0], 0.1 * np.arange(N), atol=0.02)
    np.testing.assert_allclose(poses[:N, 1:], 0.0, atol=1e-9)
    np.testing.assert_allclose(poses[N:, 1], 0.1 * np.arange(N), atol=0.02)
    np.testing.assert_allclose(poses[N:, 2], 1.0, atol=1e-9)


def test_without_odometry_too(tmp_path: Path) -> None:
    log = open_log(bf.write_bag(tmp_path, restarted(odometry=False)))
    assert any("begins again once" in text for text in log.warnings)
    assert (np.diff([scan.stamp for scan in log]) > 0.0).all()


def test_a_clock_of_the_laser_alone_is_none_of_a_simulation(tmp_path: Path) -> None:
    log = open_log(bf.write_bag(tmp_path, restarted(restarts_odometry=False)))
    assert not any("begins again" in text for text in log.warnings)


def test_recording_times_that_begin_again_too(tmp_path: Path) -> None:
    """As rosbag records a simulation by its own clock: both runs lie at the same times, in the order of the file."""
    sent = [one._replace(bag_stamp=one.bag_stamp - 8.0 * (k >= 2 * N)) for k, one in enumerate(restarted())]
    log = open_log(bf.write_bag(tmp_path, sent, is_sorted=True))
    assert any("begins again once, first at scan 60, by up to 5.9 s" in text for text in log.warnings)
    scans = list(log)
    assert len(scans) == 2 * N
    assert (np.diff([scan.stamp for scan in scans]) > 0.0).all()
    assert [scan.ranges[0] for scan in scans] == [1.0] * N + [2.0] * N
    poses = np.array([odometry_of(scan) for scan in scans])
    np.testing.assert_allclose(poses[:N], np.outer(0.1 * np.arange(N), [1.0, 0.0, 0.0]), atol=0.02)
    np.testing.assert_allclose(poses[N:, 1], 0.1 * np.arange(N), atol=0.02)
    np.testing.assert_allclose(poses[N:, 2], 1.0, atol=1e-9)
    assert [scan.stamp for scan in log] == [scan.stamp for scan in scans]


def test_topics_one_after_the_other_are_one_run(tmp_path: Path) -> None:
    """As of two recordings that were put together without sorting."""
    sent = sorted(restarted()[: 2 * N], key=lambda one: one.topic)
    log = open_log(bf.write_bag(tmp_path, sent, is_sorted=True))
    assert not any("begins again" in text for text in log.warnings)
    poses = np.array([odometry_of(scan) for scan in log])
    np.testing.assert_allclose(poses[:, 0], 0.1 * np.arange(N), atol=0.02)


@pytest.mark.parametrize(
    ("stamps", "expected"),
    [
        (np.arange(50.0), []),
        (np.concatenate([np.arange(50.0), np.arange(30.0)]), [50]),
        (np.concatenate([np.arange(50.0), np.arange(30.0), np.arange(9.0)]), [50, 80]),
        (np.where(np.arange(50) == 20, 3.0, np.arange(50.0)), []),  # one that is wrong
        (np.where(np.arange(50) == 20, 99.0, np.arange(50.0)), []),
        (np.where(np.arange(50) == 20, np.nan, np.arange(50.0)), []),
        (np.arange(50.0) - 0.9 * (np.arange(50) % 2), []),
        ((np.arange(50.0) + 2.0**32 - 25.0) % 2.0**32, []),  # a counter that wraps
        (np.empty(0), []),
    ],
)
def test_restarts(stamps: np.ndarray, expected: list[int]) -> None:
    assert restarts(stamps).tolist() == expected
