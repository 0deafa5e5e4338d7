"""The overview picture: not blank, and there for every shape of run."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from slammot_graph import Run
from slammot_graph.overview import draw_overview
from slammot_graph.result_types import GraphEdge, GridMap, RunResult
from tests.rooms import drive


@cache
def result() -> RunResult:
    return Run(drive(40)).complete()


def picture(run: RunResult, path: Path) -> np.ndarray:
    draw_overview(run, path)
    return imread(path)


def n_colors(image: np.ndarray) -> int:
    return len(np.unique((image[..., :3] * 255).astype(int).reshape(-1, 3), axis=0))


def test_a_run_gives_a_picture_of_map_and_trajectory(tmp_path: Path) -> None:
    image = picture(result(), tmp_path / "overview.png")
    assert min(image.shape[:2]) > 300
    assert n_colors(image) > 20
    dark = (image[..., :3] < 0.2).all(axis=2)
    assert dark.sum() > 100  # walls and text


def test_a_closure_is_drawn(tmp_path: Path) -> None:
    run = replace(result(), edges=())
    last = len(run.nodes) - 1
    closure = GraphEdge(
        kind="closure", from_node=0, to_node=last, T_from_to=np.zeros(3), information=np.eye(3)
    )
    without = picture(run, tmp_path / "without.png")
    with_one = picture(replace(run, edges=(closure,)), tmp_path / "with.png")
    assert without.shape != with_one.shape or np.abs(without - with_one).max() > 0.1


@pytest.mark.parametrize("shape", [(1, 1), (3, 400), (5000, 40)])
def test_maps_of_any_size_are_drawn(tmp_path: Path, shape: tuple[int, int]) -> None:
    p = np.full(shape, 0.05)
    p[0] = 0.95
    grid = GridMap(p_occupied=p, resolution_m=0.05, origin=np.array([-1.0, -1.0]))
    image = picture(replace(result(), grid=grid), tmp_path / "overview.png")
    assert max(image.shape[:2]) < 6000
    assert n_colors(image) > 5


def test_a_run_without_tracks_nodes_or_map_is_drawn(tmp_path: Path) -> None:
    nothing = GridMap(p_occupied=np.full((1, 1), np.nan), resolution_m=0.05, origin=np.zeros(2))
    run = replace(
        result(), tracks=np.empty((0, 10)), nodes=np.empty((0, 3)), edges=(), grid=nothing, is_complete=False
    )
    assert n_colors(picture(run, tmp_path / "overview.png")) > 5
