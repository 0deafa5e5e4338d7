"""What speaks for a place, and what against it."""

import math

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.loop_closure.place_evidence import Evidence, PlacedKeyframe, placed_keyframes, weigh_place
from slammot_graph.loop_closure.submap import Submap
from slammot_graph.mapping.local_map import Keyframe

ANGLES = np.linspace(-np.pi, np.pi, 721)[:-1]


def seen(T: FloatArray, width_m: float, depth_m: float) -> PlacedKeyframe:
    """A keyframe in a room from (0, 0) to (width, depth), where it lies."""
    directions = np.stack([np.cos(ANGLES + T[2]), np.sin(ANGLES + T[2])], axis=1)
    with np.errstate(divide="ignore"):
        to_walls = np.maximum((np.array([width_m, depth_m]) - T[:2]) / directions, -T[:2] / directions)
    ranges = to_walls.min(axis=1)[:, None]
    points = ranges * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
    keyframe = Keyframe(
        node=0, T_local_base=np.zeros(3), points_base=points, normals_base=points, laser_base=np.zeros(2)
    )
    return PlacedKeyframe(T, keyframe)


def room(xs: tuple[float, ...], width_m: float, depth_m: float = 4.0) -> list[PlacedKeyframe]:
    return [seen(np.array([x + 0.037, 1.543, 0.3 * x]), width_m, depth_m) for x in xs]


OLD = room((1.0, 1.5, 2.0, 2.5), 6.0)


def test_in_the_same_place_all_agrees() -> None:
    evidence = weigh_place(OLD, room((1.2, 2.3, 3.0, 4.0), 6.0))
    assert evidence.n_agreeing > 60  # two maps with 40 squares of 0.5 m each along 20 m of wall
    assert evidence.n_contrary == 0


def test_walls_that_one_has_seen_through_are_contrary() -> None:
    nearer, farther = (weigh_place(OLD, room((1.2, 2.3, 3.0, 4.0), width)) for width in (5.0, 8.0))
    for evidence in (nearer, farther):
        assert (
            6 <= evidence.n_contrary <= 16
        )  # 4 m of wall, in squares of 0.5 m, and where the side walls go on
        assert evidence.n_agreeing > 40


def test_what_the_other_has_not_seen_says_nothing() -> None:
    far = [PlacedKeyframe(one.T + np.array([100.0, 0.0, 0.0]), one.keyframe) for one in OLD]
    assert weigh_place(OLD, far) == Evidence(0, 0)


def test_where_both_lie_makes_no_difference() -> None:
    T = np.array([250.0, -90.0, 0.0])
    moved = [
        [PlacedKeyframe(se2.compose(T, one.T), one.keyframe) for one in part]
        for part in (OLD, room((1.2, 3.0), 5.0))
    ]
    assert tuple(weigh_place(moved[0], moved[1])) == pytest.approx(
        tuple(weigh_place(OLD, room((1.2, 3.0), 5.0))), abs=4
    )


def test_the_ratio_is_that_of_two_binomial_likelihoods() -> None:
    p, q = 0.04, 0.12
    expected = math.log((1 - p) ** 30 * p**2) - math.log((1 - q) ** 30 * q**2)
    assert Evidence(30, 2).log_ratio(p, q) == pytest.approx(expected)
    assert Evidence(0, 0).log_ratio(p, q) == 0.0


def test_a_keyframe_of_two_local_maps_counts_once() -> None:
    keyframes = tuple(one.keyframe for one in OLD)
    submaps = [Submap(k, keyframes[k : k + 3], 0.0) for k in (0, 1)]
    placed = placed_keyframes(submaps, np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]))
    assert [id(one.keyframe) for one in placed] == [id(keyframe) for keyframe in keyframes]
    assert [one.T[0] for one in placed] == [1.0, 1.0, 1.0, 2.0]
