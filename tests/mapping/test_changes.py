"""What has changed between two maps of one place."""

import numpy as np

from slammot_graph.core.results import GridMap
from slammot_graph.core.types import FloatArray
from slammot_graph.mapping.changes import covering_all, find_changes, joint_map

CELL_M = 0.05


def room(
    *boxes: tuple[int, int, int, int], shape: tuple[int, int] = (60, 80), low: tuple[int, int] = (0, 0)
) -> GridMap:
    """A free room with boxes: rows i0 to i1 and columns j0 to j1 occupied."""
    p = np.full(shape, 0.05)
    p[[0, -1]] = p[:, [0, -1]] = 0.95
    for i0, i1, j0, j1 in boxes:
        p[i0:i1, j0:j1] = 0.95
    return GridMap(p_occupied=p, resolution_m=CELL_M, origin=CELL_M * np.array(low, dtype=np.float64))


def cells(points: FloatArray) -> set[tuple[int, int]]:
    return {(int(y / CELL_M), int(x / CELL_M)) for x, y in points}


def test_a_box_that_was_moved_is_new_here_and_gone_there() -> None:
    changes = find_changes(room((10, 16, 10, 16)), room((10, 16, 40, 46)))
    assert cells(changes.new_points) == {(i, j) for i in range(10, 16) for j in range(40, 46)}
    assert cells(changes.gone_points) == {(i, j) for i in range(10, 16) for j in range(10, 16)}


def test_walls_that_lie_a_cell_aside_have_not_changed() -> None:
    changes = find_changes(room((10, 12, 10, 60)), room((11, 13, 11, 61)))
    assert not changes.is_new.any()
    assert not changes.is_gone.any()


def test_a_few_stray_cells_are_no_change() -> None:
    changes = find_changes(room(), room((20, 21, 20, 22), (40, 41, 60, 61)))
    assert not changes.is_new.any()


def test_what_was_never_seen_before_is_not_new() -> None:
    before = room()
    before.p_occupied[:, 40:] = np.nan
    changes = find_changes(before, room((10, 16, 50, 56)))
    assert not changes.is_new.any()


def test_maps_of_other_windows_are_laid_on_each_other() -> None:
    before = room((10, 16, 10, 16))
    small = room((2, 8, 12, 18), shape=(30, 40), low=(20, 30))  # rows and columns 32 to 37 of the large one
    small.p_occupied[[0, -1]] = small.p_occupied[:, [0, -1]] = np.nan
    changes = find_changes(before, small)
    assert cells(changes.new_points) == {(i, j) for i in range(32, 38) for j in range(32, 38)}
    assert not changes.is_gone.any()
    both = joint_map(before, small)
    assert both.p_occupied.shape == before.p_occupied.shape
    assert both.p_occupied[12, 12] > 0.8
    assert both.p_occupied[34, 34] > 0.8


def test_the_joint_map_keeps_what_is_there_now() -> None:
    before, now = room((10, 16, 10, 16)), room((10, 16, 40, 46))
    now.p_occupied[:, 60:] = np.nan
    both = joint_map(before, now).p_occupied
    assert both[12, 12] < 0.2
    assert both[12, 42] > 0.8
    np.testing.assert_array_equal(both[:, 60:], before.p_occupied[:, 60:])


def test_points_beside_what_is_new_are_of_it() -> None:
    changes = find_changes(room(), room((10, 16, 40, 46)))
    points = CELL_M * np.array([[43.5, 13.5], [46.9, 13.5], [50.0, 13.5], [np.nan, 1.0], [1e6, 0.0]])
    assert changes.are_new(points).tolist() == [True, True, False, False, False]
    assert not changes.are_gone(points).any()
    assert (changes.new_cells(points) >= 0).tolist() == changes.are_new(points).tolist()


def test_few_local_maps_show_all_that_is_new() -> None:
    cells_of = [np.arange(0, 5), np.arange(3, 20), np.arange(5, 12), np.arange(18, 21), np.arange(30, 40)]
    chosen = covering_all(cells_of, np.array([True, False, False, False, False]))
    assert chosen.tolist() == [False, True, False, False, True]
    assert not covering_all(cells_of, np.ones(5, dtype=np.bool_)).any()
