"""The picture of a saved map, from the points of its keyframes."""

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from slammot_graph.core import se2
from slammot_graph.core.saved_map_parts import joined_keyframes, keyframe_places, points_in_map
from slammot_graph.mapping.final_map import FinalMapConfig
from slammot_graph.mapping.occupancy_grid import GridConfig
from slammot_graph.mapping.saved_grid import aligned, render_saved_map
from tests.localization.saved_maps import ring_map
from tests.loop_closure.ring import WALLS, ring_log


def walls_in_map() -> np.ndarray:
    share = np.linspace(0.0, 1.0, 1000)[:, None]
    points = np.vstack([a + share * (b - a) for a, b in ((wall[:2], wall[2:]) for wall in WALLS)])
    return se2.transform(se2.inverse(ring_log(1).T_world_base[0]), points)


def test_the_picture_shows_the_walls_and_the_space_between() -> None:
    grid = render_saved_map(ring_map(), GridConfig(), FinalMapConfig())
    rows, cols = np.nonzero(grid.p_occupied > 0.8)
    occupied = grid.origin + grid.resolution_m * (np.column_stack([cols, rows]) + 0.5)
    walls = walls_in_map()
    apart = np.asarray(cKDTree(walls).query(occupied)[0])
    assert apart.max() < 0.2
    assert np.mean(cKDTree(occupied).query(walls)[0] < 0.1) > 0.75  # but for sides that no beam reaches
    path = se2.between(ring_log(1).T_world_base[0], ring_log(1).T_world_base)[:, :2]
    cells = np.floor((path - grid.origin) / grid.resolution_m).astype(np.int64)
    assert (grid.p_occupied[cells[:, 1], cells[:, 0]] < 0.2).all()


def test_keyframes_lie_where_the_robot_was() -> None:
    saved = ring_map()
    places = keyframe_places(saved)
    has_node = saved.keyframe_nodes >= 0
    nodes = saved.nodes[saved.keyframe_nodes[has_node]]
    assert np.hypot(*(places[has_node] - nodes)[:, :2].T).max() < 0.1
    apart = np.asarray(cKDTree(walls_in_map()).query(points_in_map(saved))[0])
    assert apart.max() < 0.25


def test_only_local_maps_in_a_known_place_are_shown() -> None:
    apart = replace(ring_map(), joined=())
    assert not joined_keyframes(apart).any()
    grid = render_saved_map(apart, GridConfig(), FinalMapConfig())
    assert not np.isfinite(grid.p_occupied).any()
    whole = render_saved_map(ring_map(), GridConfig(), FinalMapConfig())
    (a, b), low = aligned(whole, grid)
    np.testing.assert_array_equal(a, whole.p_occupied)
    assert np.isnan(b).all()
    np.testing.assert_allclose(low * whole.resolution_m, whole.origin)
