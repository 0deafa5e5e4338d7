import math

import numpy as np
import pytest

from slammot_graph.core.errors import InputError
from slammot_graph.core.results import GridMap
from slammot_graph.core.types import FloatArray
from slammot_graph.evaluation import evaluate_map


def grid(p: FloatArray, x: float = 0.0, y: float = 0.0, resolution_m: float = 0.5) -> GridMap:
    return GridMap(p_occupied=p, resolution_m=resolution_m, origin=np.array([x, y]))


@pytest.fixture
def room() -> FloatArray:
    p = np.full((12, 16), 0.1)
    p[0] = p[-1] = 0.95
    p[:, 0] = p[:, -1] = 0.95
    p[5:7, 12:14] = math.nan
    return p


def test_a_map_equals_itself(room: FloatArray) -> None:
    scores = evaluate_map(grid(room), grid(room))
    assert (scores.n_ghost_cells, scores.n_lost_wall_cells, scores.n_unseen_wall_cells) == (0, 0, 0)
    assert scores.n == 2 * 16 + 2 * 10
    assert scores.area_m2 == pytest.approx((12 * 16 - 4) * 0.25)
    assert scores.ghosts_per_m2 == 0.0


def test_ghosts_and_lost_walls_are_counted(room: FloatArray) -> None:
    p = room.copy()
    p[3, 4:6] = 0.9  # in the free space
    p[5, 12] = 0.9  # the reference has not seen it
    p[1, 8] = 0.9  # beside a wall
    p[4:9, 0] = 0.1  # the middle three are farther than one cell from what is left
    p[5, 0] = math.nan
    scores = evaluate_map(grid(p), grid(room))
    assert scores.n_ghost_cells == 2
    assert (scores.n_lost_wall_cells, scores.n_unseen_wall_cells) == (3, 1)
    assert scores.ghosts_per_m2 == pytest.approx(2 / 47.0)
    assert evaluate_map(grid(p), grid(room), tolerance_cells=0).n_ghost_cells == 3


def test_origins_may_differ(room: FloatArray) -> None:
    p = room.copy()
    p[3, 4:6] = 0.9
    larger = np.full((20, 30), math.nan)
    larger[4:16, 7:23] = p
    for shift in (0.0, 0.1, -0.1):
        moved = grid(larger, x=-3.5 + shift, y=-2.0)
        scores = evaluate_map(moved, grid(room))
        assert (scores.n_ghost_cells, scores.n_lost_wall_cells) == (2, 0)
    cut = evaluate_map(grid(room[3:, 2:], x=1.0, y=1.5), grid(room))
    assert cut.n_lost_wall_cells == cut.n_unseen_wall_cells > 0


def test_a_map_elsewhere_has_lost_every_wall(room: FloatArray) -> None:
    scores = evaluate_map(grid(room, x=100.0), grid(room))
    assert scores.n_lost_wall_cells == scores.n_wall_cells


def test_nothing_seen_is_nan() -> None:
    empty = grid(np.full((2, 2), math.nan))
    scores = evaluate_map(empty, empty)
    assert scores.n == 0
    assert math.isnan(scores.ghosts_per_m2) and math.isnan(scores.lost_walls_per_m2)


def test_resolutions_must_agree(room: FloatArray) -> None:
    with pytest.raises(InputError, match="one resolution"):
        evaluate_map(grid(room, resolution_m=0.1), grid(room))
