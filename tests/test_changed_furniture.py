"""A run in a saved map after the furniture was moved: what changed is labelled, and the map shows what is there now."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from experiments.saved_maps import points_on
from slammot_graph import MapStart, Run, RunResult, SavedMap
from slammot_graph.core import se2
from slammot_graph.core.saved_map_parts import points_in_map
from slammot_graph.simulation import SCENARIOS, SimulatedLog, simulate
from slammot_graph.simulation.furniture import with_moved_furniture
from slammot_graph.simulation.worlds import world_named

LAB = replace(SCENARIOS["lab"], rate_hz=5.0, n_laps=1)
SEED, MOVED, MOVED_SEED = 1, 0.2, 1


def log(run: int, share: float) -> SimulatedLog:
    return simulate(replace(LAB, moved=share, moved_seed=MOVED_SEED), seed=SEED + 1000 * run, n_people=0)


@cache
def first_map() -> SavedMap:
    saved = Run(log(0, 0.0)).complete().saved_map
    assert saved is not None
    return saved


@cache
def second(share: float, *, localize: bool) -> RunResult:
    return Run(log(1, share), start=MapStart(saved=first_map(), localize=localize)).complete()


def rmse_m(result: RunResult) -> float:
    truth = se2.between(log(0, 0.0).T_world_base[0], log(1, 0.0).T_world_base)
    offset = (result.T_map_base - truth)[result.health != "lost", :2]
    return float(np.sqrt(np.mean(np.sum(offset**2, axis=1))))


@pytest.mark.parametrize("localize", [False, True])
def test_moved_furniture_is_labelled_and_does_not_pull_the_pose(localize: bool) -> None:
    result = second(MOVED, localize=localize)
    world, is_moved = with_moved_furniture(world_named("lab"), MOVED, MOVED_SEED)
    truth = points_on(log(1, MOVED), world.segments[is_moved]) & result.is_valid
    assert result.is_changed is not None
    n_right = np.count_nonzero(result.is_changed & truth)
    assert n_right > 0.9 * np.count_nonzero(result.is_changed)
    assert n_right > 0.9 * np.count_nonzero(truth)
    assert rmse_m(result) < 1.5 * rmse_m(second(0.0, localize=localize)) + 1e-3


@pytest.mark.parametrize("localize", [False, True])
def test_nothing_is_labelled_where_nothing_was_moved(localize: bool) -> None:
    result = second(0.0, localize=localize)
    assert result.is_changed is not None
    assert np.count_nonzero(result.is_changed) < 1e-3 * np.count_nonzero(result.is_valid)


def test_the_map_keeps_what_is_there_now() -> None:
    result = second(MOVED, localize=False)
    grid, saved = result.grid, result.saved_map
    assert saved is not None

    def p_at(points: np.ndarray) -> np.ndarray:
        cells = np.floor((points - grid.origin) / grid.resolution_m).astype(np.int64)
        return np.asarray(grid.p_occupied[cells[:, 1], cells[:, 0]])

    assert len(result.gone_points) > 5
    assert (p_at(result.gone_points) < 0.2).all()
    assert (p_at(result.new_points) > 0.8).all()

    def n_near(of: SavedMap, places: np.ndarray) -> int:
        points = points_in_map(of)
        apart = np.abs(points[:, None] - places[None]).max(axis=2)
        return int(np.count_nonzero(apart.min(axis=1) < 0.04))

    assert n_near(first_map(), result.gone_points) > 20
    assert n_near(saved, result.gone_points) <= 3  # a return of the later run between two surfaces
    assert n_near(first_map(), result.new_points) == 0
    assert n_near(saved, result.new_points) > 20
    SavedMap.from_bytes(saved.to_bytes())


def test_a_run_in_known_places_adds_hardly_anything_to_the_map() -> None:
    saved = second(0.0, localize=False).saved_map
    assert saved is not None
    assert len(saved.submaps) <= len(first_map().submaps) + 3


def test_labels_are_written_for_runs_that_start_from_a_map(tmp_path: Path) -> None:
    result = second(MOVED, localize=True)
    result.save(tmp_path / "run")
    with np.load(tmp_path / "run" / "points.npz") as points:
        np.testing.assert_array_equal(points["changed"], result.is_changed)
        np.testing.assert_array_equal(points["new_points"], result.new_points)
        np.testing.assert_array_equal(points["gone_points"], result.gone_points)


def test_a_run_that_is_not_found_labels_nothing() -> None:
    result = Run(log(1, 0.0), start=MapStart(saved=first_map(), localize=True), max_scans=5).complete()
    assert result.is_changed is None
    assert not len(result.new_points)
