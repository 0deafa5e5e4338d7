"""Two lasers, front and rear, in one run: one map, one trajectory, and who took which scan."""

import math
from pathlib import Path

import numpy as np

from slammot_graph.evaluation import absolute_error
from slammot_graph.logs import open_log
from slammot_graph.run import Run
from slammot_graph.simulation import simulate
from slammot_graph.simulation.scenarios import Scenario

TWO = Scenario(name="lab-two", world="lab", mountings=((0.2, 0.0, 0.0), (-0.2, 0.0, math.pi)))


def test_two_lasers_make_one_trajectory(tmp_path: Path) -> None:
    log = simulate(TWO, seed=1, n_people=0)
    log.write(tmp_path / "log.npz")
    read = open_log(tmp_path / "log.npz")
    result = Run(read, max_scans=400).complete()
    truth = log.T_world_base[:400]
    assert absolute_error(result.T_map_base, truth).translation_m.rmse < 0.01
    assert result.n_failed_matches <= 1  # the first scan of the rear meets no map
    assert result.laser is not None
    assert result.laser.tolist() == [0, 1] * 200
    result.save(tmp_path / "run")
    with np.load(tmp_path / "run" / "points.npz") as points:
        np.testing.assert_array_equal(points["laser"], result.laser)


def test_the_laser_alone_when_two_scan_a_few_milliseconds_apart() -> None:
    log = simulate(TWO, seed=2, n_people=0, noise_scale=0.0)
    # the rear scans 3 ms after the front: velocities between the two would be noise
    log.stamps = log.stamps.copy()
    log.stamps[1::2] = log.stamps[0:-1:2][: len(log.stamps[1::2])] + 0.003
    moved = log.T_world_base[1::2] - log.T_world_base[0:-1:2][: len(log.T_world_base[1::2])]
    assert (
        np.abs(moved[:, :2]).max() < 0.04
    )  # the simulated stamps differ by 50 ms: an error of so much in a scan
    alone = log.with_odometry(np.full_like(log.T_odom_base, np.nan))
    result = Run(alone, max_scans=400).complete()
    assert result.n_failed_matches <= 1  # the first scan of the rear meets no map
    assert absolute_error(result.T_map_base, log.T_world_base[:400]).translation_m.rmse < 0.03


def test_two_lasers_that_sweep() -> None:
    log = simulate(TWO, seed=4, n_people=0, sweep=1.0)
    result = Run(log, max_scans=400).complete()
    assert result.n_failed_matches <= 1
    assert absolute_error(result.T_map_base, log.T_world_base[:400]).translation_m.rmse < 0.01
    assert len(result.tracks) == 0
