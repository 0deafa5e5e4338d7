"""A saved map edited by hand: closures out and in, places erased."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from slammot_graph import InputError, SavedMap
from slammot_graph.core.saved_map_parts import points_in_map
from slammot_graph.saved_maps import edit_map
from tests.localization.saved_maps import ring_map
from tests.saved_maps.two_halves import half_map, merged


def closures_of(saved: SavedMap) -> list[tuple[int, int]]:
    return [(edge.from_node, edge.to_node) for edge in saved.edges if edge.kind == "closure"]


@cache
def without_closures() -> SavedMap:
    return edit_map(ring_map(), reject_closures=sorted(set(closures_of(ring_map()))))


def test_rejected_closures_are_gone_and_the_map_is_optimised_anew() -> None:
    edited = without_closures()
    assert not closures_of(edited)
    assert len(edited.edges) == len(ring_map().edges) - len(closures_of(ring_map()))
    assert np.abs(edited.nodes - ring_map().nodes).max() > 1e-3
    assert edited.edits[0].startswith("reject-closure ")
    assert SavedMap.from_bytes(edited.to_bytes()).edits == edited.edits


def test_a_closure_is_found_for_two_nodes() -> None:
    both, n = merged().saved, len(half_map(0).nodes)
    before = [edge for edge in both.edges if edge.kind == "closure" and edge.from_node < n <= edge.to_node][5]
    a, b = before.from_node, before.to_node
    rejected = edit_map(both, reject_closures=[(b, a)])
    edited = edit_map(rejected, add_closures=[(a, b)])
    (edge,) = [edge for edge in edited.edges if (edge.from_node, edge.to_node) == (a, b)]
    np.testing.assert_allclose(edge.T_from_to, before.T_from_to, atol=0.01)
    np.testing.assert_allclose(edited.nodes, both.nodes, atol=0.01)
    assert edited.edits == (f"reject-closure {b}-{a}", f"add-closure {a}-{b}")


def test_erased_points_are_gone() -> None:
    points = points_in_map(ring_map())
    x, y = np.round(points[len(points) // 2], 1).tolist()
    edited = edit_map(ring_map(), erase=[(x + 0.5, y - 0.5, x - 0.5, y + 0.5)])
    is_inside = (np.abs(points - (x, y)) <= 0.5).all(axis=1)
    assert is_inside.any()
    assert len(edited.points) == np.count_nonzero(~is_inside)
    left = points_in_map(edited)
    assert not (np.abs(left - (x, y)) < 0.5).all(axis=1).any()
    np.testing.assert_array_equal(edited.nodes, ring_map().nodes)
    edited._check()


def test_a_local_map_with_nothing_left_is_gone() -> None:
    edited = edit_map(ring_map(), erase=[(-100.0, -100.0, 100.0, 100.0)])
    assert not edited.submaps
    assert not len(edited.points)
    assert len(edited.nodes) == len(ring_map().nodes)
    SavedMap.from_bytes(edited.to_bytes())


@pytest.mark.parametrize(
    ("edits", "text"),
    [
        ({"reject_closures": [(0, 99999)]}, "node 99999: the map has nodes 0 to"),
        ({"reject_closures": [(0, 1)]}, "reject-closure 0-1: no closure ties these nodes"),
        ({"add_closures": [(0, 0)]}, "both nodes are of one local map"),
        ({"erase": [(0.0, 0.0, 0.0, 1.0)]}, "is no rectangle"),
        ({"erase": [(0.0, 0.0, np.nan, 1.0)]}, "is no rectangle"),
    ],
)
def test_what_cannot_be_done_is_told(edits: dict[str, list[tuple[float, ...]]], text: str) -> None:
    with pytest.raises(InputError, match=text):
        edit_map(ring_map(), **edits)  # type: ignore[arg-type]


def test_places_that_do_not_agree_are_not_tied() -> None:
    saved = ring_map()
    far = max(
        range(len(saved.submaps)), key=lambda k: saved.nodes[saved.keyframe_nodes[saved.submaps[k][0]], 0]
    )
    anchors = [int(saved.keyframe_nodes[saved.submaps[k][0]]) for k in (0, far)]
    blank = replace(saved, points=saved.points * 0.3)
    with pytest.raises(InputError, match="do not show one place"):
        edit_map(blank, add_closures=[(anchors[0], anchors[1])])
