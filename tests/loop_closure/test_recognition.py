"""Two local maps, and whether they show the same place."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.graph import PoseGraph, PoseGraphConfig
from slammot_graph.loop_closure import LoopCloser, LoopClosureConfig, Submap
from slammot_graph.mapping.local_map import LocalMapConfig, make_keyframe
from tests.rooms import CORRIDOR, HALL, LASER, ROOM, box, errors, take_scan

A, B = np.array([2.0, 0.0, 1.5]), np.array([1.0, 1.0, 2.5])
NO_DRIFT = np.zeros(3)
N = 9
SQUARE = box(-4, -4, 4, 4)

Meet = Callable[..., tuple[LoopCloser, bool, list[str]]]


def drive_from(T_world_base: FloatArray, turn: float) -> FloatArray:
    return np.array([se2.compose(T_world_base, np.array([0.1 * k, 0.0, turn * k])) for k in range(N)])


def make_submap(number: int, places: FloatArray, walls: FloatArray, path_m: float) -> Submap:
    keyframes = []
    for k, T in enumerate(places):
        scan, T_local = take_scan(T, walls=walls), se2.between(places[0], T)
        node = k if number == 0 else N + k
        keyframes.append(
            make_keyframe(node, T_local, scan.points_base(), scan.is_valid(), LASER, LocalMapConfig())
        )
    return Submap(number, tuple(keyframes), path_m)


@pytest.fixture
def meet() -> Iterator[Meet]:
    """A place seen from A, a place seen from B after 20 m, and what the closer makes of it."""
    graph = PoseGraph(PoseGraphConfig())

    def meet(
        there: FloatArray = ROOM,
        here: FloatArray = ROOM,
        drift: FloatArray = NO_DRIFT,
        T_b: FloatArray = B,
        path_m: float = 20.0,
        turn: float = 0.04,
        **changes: Any,
    ) -> tuple[LoopCloser, bool, list[str]]:
        truth = np.vstack([drive_from(A, turn), drive_from(T_b, turn)])
        graph.start(np.zeros(3))
        for k in range(1, 2 * N):
            step, std = se2.between(truth[k - 1], truth[k]), np.array([0.005, 0.005, 0.002])
            if k == N:
                step, std = se2.compose(step, drift), np.array([0.1, 0.1, 0.03])
            graph.add_node(se2.compose(graph.pose(k - 1), step))
            graph.add_edge("odometry", k - 1, k, step, np.linalg.inv(np.diag(std) ** 2))
            graph.update()
        closer = LoopCloser(replace(LoopClosureConfig(), **changes), LocalMapConfig(), graph)
        assert closer.consider(make_submap(0, truth[:N], there, 0.0)) == ()
        attempts = closer.consider(make_submap(5, truth[N:], here, path_m))
        has_closed = any(attempt.status == "accepted" for attempt in attempts)
        assert has_closed == any(edge.kind == "closure" for edge in graph.edges)
        return closer, has_closed, [attempt.text for attempt in attempts]

    yield meet
    graph.close()


@pytest.mark.parametrize("drift", [[0.0, 0.0, 0.0], [0.3, -0.2, 0.1], [-1.2, 0.5, -0.05]])
def test_a_place_is_recognised_and_the_drift_mended(meet: Meet, drift: list[float]) -> None:
    closer, changed, events = meet(drift=np.array(drift))
    assert (changed, events) == (True, ["closure 0-9 accepted"])
    ((closure, _),) = closer.accepted
    np.testing.assert_allclose(closure.T_target_source, se2.between(A, B), atol=5e-3)
    np.testing.assert_allclose(closure.cov @ closure.information, np.eye(3), atol=1e-4)
    nodes = closer.graph.poses()
    np.testing.assert_allclose(se2.between(nodes[0], nodes[N]), se2.between(A, B), atol=0.02)
    (edge,) = (edge for edge in closer.graph.edges if edge.kind == "closure")
    assert (edge.from_node, edge.to_node) == (0, N)
    np.testing.assert_array_equal(edge.T_from_to, closure.T_target_source)


def test_a_place_is_recognised_coming_from_the_other_side(meet: Meet) -> None:
    T_b = np.array([2.0, 0.5, A[2] + np.pi])
    closer, changed, _ = meet(T_b=T_b, drift=np.array([0.2, 0.1, -0.06]))
    assert changed
    assert max(errors(se2.between(A, T_b), closer.accepted[0][0].T_target_source)) < 5e-3


def assert_refused(outcome: tuple[LoopCloser, bool, list[str]], reason: str) -> None:
    closer, changed, events = outcome
    assert not changed
    assert len(events) == 1
    assert events[0].startswith("closure 0-9 refused: ")
    assert reason in events[0]
    assert not closer.accepted
    assert not closer.pending
    assert all(edge.kind == "odometry" for edge in closer.graph.edges)
    assert len(closer.submaps) == 2


def test_another_place_is_refused(meet: Meet) -> None:
    assert_refused(meet(here=HALL), "no pose agrees")


def test_a_place_farther_off_than_the_search_is_refused(meet: Meet) -> None:
    assert_refused(meet(drift=np.array([5.5, 0.0, 0.0])), "no pose agrees")


def test_a_room_that_looks_alike_from_two_sides_is_ambiguous(meet: Meet) -> None:
    # a quarter turn is within the search, and a square seen all round looks the same after it
    T_b = np.array([0.1, 0.2, A[2] + 0.6])
    outcome = meet(SQUARE, SQUARE, T_b=T_b, turn=0.7, max_search_rad=2.0, sigma_scale=14.0)
    assert_refused(outcome, "ambiguous: another pose scores ")


def test_a_wall_that_stands_in_what_was_free_violates_free_space(meet: Meet) -> None:
    blocked = np.vstack([ROOM, box(0.8, 1.6, 3.2, 2.0), box(-2.5, -2.0, -2.2, 2.0), box(2.5, -1.5, 3.0, 0.8)])
    outcome = meet(here=blocked, min_score=0.2, min_overlap=0.2, max_free_space_violation=0.05)
    assert_refused(outcome, "of the points lie where the other saw free space")


def test_too_little_overlap_is_refused(meet: Meet) -> None:
    assert_refused(meet(min_overlap=1.0), "overlap of ")


def test_along_a_corridor_a_closure_says_nothing(meet: Meet) -> None:
    start = np.array([0.0, 0.1, 0.02])
    closer, _, events = meet(CORRIDOR, CORRIDOR, T_b=start)
    for closure in [*(closure for closure, _ in closer.accepted), *closer.pending]:
        along = np.array([*(se2.rotation(-start[2]) @ [1.0, 0.0]), 0.0])
        assert along @ closure.information @ along < 1e-3 * np.trace(closure.information)
    assert len(events) == 1


@pytest.mark.parametrize(("path_m", "is_tried"), [(7.9, False), (8.1, True)])
def test_only_after_some_path_length_places_are_compared(meet: Meet, path_m: float, is_tried: bool) -> None:
    _, changed, events = meet(path_m=path_m)
    assert changed == is_tried
    assert len(events) == is_tried


def test_places_far_from_each_other_are_not_compared(meet: Meet) -> None:
    _, changed, events = meet(T_b=np.array([9.0, 1.0, 0.0]), here=HALL, max_distance_m=5.0)
    assert (changed, events) == (False, [])
