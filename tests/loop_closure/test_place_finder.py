"""A local map looked for in a whole saved map."""

import numpy as np

from slammot_graph.core import se2
from slammot_graph.loop_closure import LoopClosureConfig
from slammot_graph.loop_closure.place_finder import COVER_M, COVER_RAD, PlaceFinder, covering
from slammot_graph.loop_closure.saved_submaps import load_submaps
from slammot_graph.loop_closure.submap import Submap
from slammot_graph.loop_closure.verification import Verifier
from slammot_graph.mapping.local_map import LocalMapConfig
from tests.localization.saved_maps import ring_map

CONFIG = LoopClosureConfig()


def submaps() -> list[Submap]:
    return load_submaps(ring_map(), CONFIG.submap)


def finder(initial_pose: np.ndarray | None = None, *, without: int = -1) -> PlaceFinder:
    targets = [submap for submap in submaps() if submap.number != without]
    return PlaceFinder(Verifier(CONFIG, LocalMapConfig()), targets, ring_map().nodes, initial_pose)


def view_of(submap: Submap) -> np.ndarray:
    view = submap.T_anchor_keyframes[len(submap.keyframes) // 2].copy()
    view[:2] = submap.centre
    return se2.compose(ring_map().nodes[submap.anchor], view)


def test_the_targets_cover_the_map() -> None:
    chosen = covering(submaps(), ring_map().nodes)
    assert 3 < len(chosen) <= len(submaps())
    views = np.array([view_of(submap) for submap in chosen])
    for submap in submaps():
        offset = se2.between(view_of(submap)[None], views)
        is_near = (np.hypot(offset[:, 0], offset[:, 1]) < COVER_M) & (np.abs(offset[:, 2]) < COVER_RAD)
        assert is_near.any()


def test_a_local_map_is_found_among_all() -> None:
    """Its neighbours share keyframes with it; where it lies is told by none of the poses that it is given with."""
    nodes = ring_map().nodes
    for number in (2, 6, 9):
        source = submaps()[number]
        moved = nodes.copy()
        found = finder(without=number).find(Submap(99, source.keyframes, 0.0, 1, CONFIG.submap), moved)
        assert len(found) == 1
        place = se2.compose(nodes[found[0].target.anchor], found[0].T_target_source)
        offset = se2.between(nodes[source.anchor], place)
        assert np.hypot(offset[0], offset[1]) < 0.05
        assert abs(offset[2]) < 0.01


def test_a_place_far_from_the_guess_is_left_out() -> None:
    nodes, source = ring_map().nodes, submaps()[6]
    new = Submap(99, source.keyframes, 0.0, 1, CONFIG.submap)
    # the component lies where it does already: its first pose is the map's origin
    assert len(finder(np.array([0.5, -0.5, 0.1]), without=6).find(new, nodes)) == 1
    assert finder(np.array([9.0, 0.0, 0.0]), without=6).find(new, nodes) == []
    assert finder(np.array([0.0, 0.0, 2.0]), without=6).find(new, nodes) == []
