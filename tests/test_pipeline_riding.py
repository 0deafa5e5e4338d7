"""What comes up before the laser and rides along with the robot: in the map it would hold the robot back."""

from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from slammot_graph import Run, open_log
from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.evaluation import absolute_error
from slammot_graph.pipeline import Pipeline, PipelineConfig
from slammot_graph.simulation import SimulatedLog, simulate

CORRIDORS = [
    ("building", 90, 1900, 5),
    ("building", 90, 1900, 9),
    ("office", 91, 1160, 9),
]
N_BEFORE, N_RIDING, LASER_HEIGHT_M, PITCH_RAD = 300, 60, 0.3, 0.12


def cover(ranges: FloatArray, angles: FloatArray) -> FloatArray:
    """Half of the beams end 1.2 m away."""
    is_before = np.arange(len(ranges)) < len(ranges) // 2
    return np.where(is_before, np.minimum(ranges, 1.2), ranges)


def on_floor(angles: FloatArray, pitch_rad: float) -> FloatArray:
    """Ranges of a laser that looks down onto the floor: a line across the way."""
    down = np.cos(angles) * np.sin(pitch_rad)
    floor: FloatArray = np.divide(LASER_HEIGHT_M, down, out=np.full(len(angles), np.inf), where=down > 1e-3)
    return floor


def ramp(ranges: FloatArray, angles: FloatArray) -> FloatArray:
    """The floor is 2.5 m ahead."""
    seen: FloatArray = np.minimum(ranges, on_floor(angles, PITCH_RAD))
    return seen


def driven(
    log: SimulatedLog,
    seen_through: Callable[[FloatArray, FloatArray], FloatArray],
    *,
    has_odometry: bool = True,
) -> FloatArray:
    """Poses as found while something rides along from one scan on."""
    rng, found = np.random.default_rng(0), list[FloatArray]()
    with Pipeline(PipelineConfig()) as pipeline:
        for k, scan in enumerate(islice(log, N_BEFORE + N_RIDING)):
            ranges = scan.ranges
            if k >= N_BEFORE:
                seen = seen_through(np.where(np.isfinite(ranges), ranges, np.inf), scan.laser.angles_base)
                ranges = np.where(seen < ranges, seen + rng.normal(0.0, 0.01, len(seen)), ranges)
            T_odom_base = scan.T_odom_base if has_odometry else None
            found.append(pipeline.step(replace(scan, ranges=ranges, T_odom_base=T_odom_base)).T_map_base)
    driven_m = np.linalg.norm(log.T_world_base[len(found) - 1, :2] - log.T_world_base[N_BEFORE, :2])
    assert driven_m > 2.0
    return np.array(found)


@pytest.mark.parametrize("seen_through", [cover, ramp])
@pytest.mark.parametrize("has_odometry", [True, False])
def test_what_rides_along_does_not_hold_the_robot_back(
    seen_through: Callable[[FloatArray, FloatArray], FloatArray], has_odometry: bool
) -> None:
    log = simulate("hall", seed=62, laser="utm30lx")
    found = driven(log, seen_through, has_odometry=has_odometry)
    assert absolute_error(found, log.T_world_base[: len(found)]).translation_m.max < 0.35


@pytest.mark.parametrize(
    ("world", "seed", "first", "degrees"),
    [("hall", 73, 380, 9), ("hall", 73, 670, 9), ("hall", 73, 960, 9), *CORRIDORS],
)
def test_a_robot_that_drives_over_a_ramp_goes_on_by_its_odometry(
    world: str, seed: int, first: int, degrees: float
) -> None:
    """The floor comes up on free cells, nearer and nearer, until it is most of what a laser of a half circle sees.

    Down a corridor the floor alone would tell of the way, however few beams it is.
    """
    pitches = np.radians(degrees) * np.interp(np.arange(150), [60, 85, 105, 130], [0.0, 1.0, 1.0, 0.0])
    log = simulate(world, seed=seed)
    rng, found = np.random.default_rng(0), list[FloatArray]()
    with Pipeline(PipelineConfig()) as pipeline:
        for k, (scan, pitch) in enumerate(zip(islice(log, first, None), pitches, strict=False)):
            floor = on_floor(scan.laser.angles_base, pitch) + rng.normal(0.0, 0.02, len(scan.ranges))
            ranges = np.fmin(scan.ranges, floor)
            found.append(pipeline.step(replace(scan, index=k, ranges=ranges)).T_map_base)
    truth = log.T_world_base[first : first + len(found)]
    assert absolute_error(np.array(found), truth).translation_m.max < 0.3


def test_the_floor_is_not_taken_for_the_wall_behind_it() -> None:
    """It looks like that wall, two metres nearer: no robot drives so far within a scan."""
    found = driven(simulate("hall", seed=73), ramp)
    assert np.linalg.norm(np.diff(found[:, :2], axis=0), axis=1).max() < 0.5


@pytest.mark.real
def test_a_wall_that_comes_into_sight_is_no_floor(recorded_data: Path) -> None:
    """Down a corridor, its far end on cells that beams have passed; kept out of map and match it grew scan by scan."""
    log = open_log(recorded_data / "bags" / "general_tracking_moving_1.bag")
    scans = list(islice(log, 400, 620))
    run = Run(scans, "graph")
    assert all(step.health != "contradiction" for step in run)
    found, told = run.result().T_map_base, [scan.T_odom_base for scan in scans]
    assert told[0] is not None
    assert told[-1] is not None
    found_way, told_way = se2.between(found[0], found[-1]), se2.between(told[0], told[-1])
    assert np.hypot(*(found_way - told_way)[:2]) < 2.0  # of 32 m; it was 10.8 m
