import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.loop_closure import Closure, LoopClosureConfig, Submap, SubmapConfig
from slammot_graph.loop_closure.verification import SearchWindow, Verifier, search_window
from slammot_graph.mapping.local_map import LocalMapConfig, make_keyframe
from tests.rooms import HALL, LASER, ROOM, box, errors, take_scan

CONFIG = LoopClosureConfig()
A, B = np.array([2.0, 0.0, 1.5]), np.array([1.0, 1.0, 2.5])
NEAR = SearchWindow(reach_m=1.0, distance_m=1.0, rotation_rad=0.3)
EVERYWHERE = SearchWindow(reach_m=1.0, distance_m=4.0, rotation_rad=math.pi, is_full_circle=True)


def submap(number: int, T_world_anchor: FloatArray, walls: FloatArray = ROOM) -> Submap:
    keyframes = []
    for k in range(9):
        T_anchor_base = np.array([0.1 * k, 0.0, 0.04 * k])
        scan = take_scan(se2.compose(T_world_anchor, T_anchor_base), walls=walls)
        keyframes.append(
            make_keyframe(k, T_anchor_base, scan.points_base(), scan.is_valid(), LASER, LocalMapConfig())
        )
    return Submap(number, tuple(keyframes), 10.0 * number)


@pytest.fixture(scope="module")
def places() -> tuple[Submap, Submap]:
    return submap(0, A), submap(5, B)


@given(st.floats(1e-4, 10.0), st.floats(1e-4, 10.0), st.floats(-3.0, 3.0), st.floats(1e-4, 3.0))
def test_the_window_covers_the_drift_within_bounds(
    a_m: float, b_m: float, turn: float, std_rad: float
) -> None:
    cov = np.zeros((3, 3))
    R = se2.rotation(turn)
    cov[:2, :2], cov[2, 2] = R @ np.diag([a_m, b_m]) ** 2 @ R.T, std_rad**2
    window = search_window(CONFIG, cov, is_apart=False)
    assert window.reach_m == pytest.approx(CONFIG.sigma_scale * max(a_m, b_m), rel=1e-6)
    assert window.distance_m == np.clip(window.reach_m, CONFIG.min_search_m, CONFIG.max_search_m)
    expected = np.clip(CONFIG.sigma_scale * std_rad, CONFIG.min_search_rad, CONFIG.max_search_rad)
    assert window.rotation_rad == pytest.approx(expected)
    assert not window.is_full_circle
    lost = search_window(CONFIG, cov, is_apart=True)
    assert lost == (window.reach_m, CONFIG.max_search_m, math.pi, True)


@pytest.mark.parametrize("off", [[0.0, 0.0, 0.0], [0.7, -0.5, 0.2]])
def test_the_same_place_is_found_near_the_prediction(places: tuple[Submap, Submap], off: list[float]) -> None:
    verifier, truth = Verifier(CONFIG, LocalMapConfig()), se2.between(A, B)
    found = verifier.verify(*places, se2.compose(truth, np.array(off)), NEAR)
    assert isinstance(found, Closure)
    assert max(errors(truth, found.T_target_source)) < 5e-3
    assert (found.target, found.source) == (places[0].place, places[1].place)
    assert found.overlap > CONFIG.min_overlap
    np.testing.assert_allclose(found.cov @ found.information, np.eye(3), atol=1e-4)


def test_with_nothing_known_all_angles_are_searched(places: tuple[Submap, Submap]) -> None:
    verifier, truth = Verifier(CONFIG, LocalMapConfig()), se2.between(A, B)
    turned = se2.compose(truth, np.array([1.0, 1.0, 2.5]))
    assert verifier.verify(*places, turned, NEAR) == "no pose agrees"
    found = verifier.verify(*places, turned, EVERYWHERE)
    assert isinstance(found, Closure)
    assert max(errors(truth, found.T_target_source)) < 5e-3


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"min_score": 1.0}, "no pose agrees"),
        ({"max_ambiguity": 0.0}, "ambiguous: another pose scores "),
        ({"min_overlap": 1.0}, "overlap of "),
    ],
)
def test_a_closure_has_to_pass_each_check(
    places: tuple[Submap, Submap], changes: dict[str, float], reason: str
) -> None:
    config = replace(CONFIG, **changes)  # type: ignore[arg-type]
    found = Verifier(config, LocalMapConfig()).verify(*places, se2.between(A, B), NEAR)
    assert isinstance(found, str)
    assert reason in found


def test_what_stands_in_free_space_is_counted_from_both_sides() -> None:
    config = replace(CONFIG, min_score=0.2, min_overlap=0.2, max_free_space_violation=0.05)
    pair = submap(0, A), submap(5, B, np.vstack([ROOM, box(0.8, 1.6, 3.2, 2.0), box(2.5, -1.5, 3.0, 0.8)]))
    for target, source, T in ((*pair, se2.between(A, B)), (*pair[::-1], se2.between(B, A))):
        found = Verifier(config, LocalMapConfig()).verify(target, source, T, NEAR)
        assert isinstance(found, str)
        assert "% of the points lie where the other saw free space" in found


def test_another_place_does_not_agree(places: tuple[Submap, Submap]) -> None:
    verifier = Verifier(CONFIG, LocalMapConfig())
    assert verifier.verify(places[0], submap(5, B, HALL), se2.between(A, B), NEAR) == "no pose agrees"


def test_grids_are_kept_for_the_latest_submaps_only(places: tuple[Submap, Submap]) -> None:
    verifier = Verifier(replace(CONFIG, n_prepared=2), LocalMapConfig())
    submaps = [replace(places[0], number=k) for k in range(3)]
    first, second = verifier.prepare(submaps[0]), verifier.prepare(submaps[1])
    assert verifier.prepare(submaps[0]) is first
    verifier.prepare(submaps[2])
    assert verifier.prepare(submaps[0]) is first
    assert verifier.prepare(submaps[1]) is not second


def test_the_search_works_on_a_coarser_grid_too() -> None:
    config = replace(CONFIG, submap=SubmapConfig(cell_m=0.2, n_levels=3))
    target, source = (replace(submap(k, T), config=config.submap) for k, T in ((0, A), (5, B)))
    found = Verifier(config, LocalMapConfig()).verify(target, source, se2.between(A, B), NEAR)
    assert isinstance(found, Closure)
    assert max(errors(se2.between(A, B), found.T_target_source)) < 5e-3
