import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slammot_graph.core.errors import InputError
from slammot_graph.core.results import GridMap
from slammot_graph.evaluation import (
    PointScores,
    beam_speeds,
    distance_to_wall,
    evaluate_points,
    evaluate_strata,
    motion_strata,
    strata,
)


def bits(text: str) -> np.ndarray:
    return np.array([c == "1" for c in text], dtype=np.bool_)


def test_counts_and_scores_of_a_known_case() -> None:
    #                    labels            truth             valid
    scores = evaluate_points(bits("1110000111"), bits("1101000001"), bits("1111111100"))
    assert scores == PointScores(n_true_positive=2, n_false_positive=2, n_false_negative=1, n_true_negative=3)
    assert (scores.n, scores.n_moving, scores.n_static) == (8, 3, 5)
    assert scores.precision == pytest.approx(2 / 4)
    assert scores.recall == pytest.approx(2 / 3)
    assert scores.f1 == pytest.approx(4 / 7)
    assert scores.iou == pytest.approx(2 / 5)
    assert scores.static_kept == pytest.approx(3 / 5)


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1))
def test_scores_agree_with_sets(pairs: list[tuple[bool, bool]]) -> None:
    labels, truth = np.array(pairs).T
    scores = evaluate_points(labels, truth)
    found = {i for i, label in enumerate(labels) if label}
    moving = {i for i, is_moving in enumerate(truth) if is_moving}
    if found | moving and len(moving) < len(pairs):
        assert scores.iou == pytest.approx(len(found & moving) / len(found | moving))
        if found and moving and found & moving:
            harmonic = 2 / (1 / scores.precision + 1 / scores.recall)
            assert scores.f1 == pytest.approx(harmonic)


def test_empty_sets_are_nan() -> None:
    nothing = evaluate_points(bits(""), bits(""))
    assert nothing.n == 0
    for score in (nothing.precision, nothing.recall, nothing.f1, nothing.iou, nothing.static_kept):
        assert math.isnan(score)
    static = evaluate_points(bits("00"), bits("00"))
    assert static.static_kept == 1.0
    assert math.isnan(static.precision) and math.isnan(static.recall) and math.isnan(static.iou)
    moving = evaluate_points(bits("10"), bits("11"))
    assert moving.recall == 0.5
    assert math.isnan(moving.precision) and math.isnan(moving.f1) and math.isnan(moving.iou)


def test_strata_by_value() -> None:
    masks = strata(np.array([0.0, 1.9, 2.0, 7.0, math.nan, math.inf]), [0, 2, 5, math.inf])
    assert list(masks) == ["0 to 2 m", "2 to 5 m", "from 5 m"]
    assert [np.flatnonzero(mask).tolist() for mask in masks.values()] == [[0, 1], [2], [3]]
    table = evaluate_strata(bits("110001"), bits("100000"), masks, bits("111110"))
    assert table["0 to 2 m"].precision == 0.5
    assert table["from 5 m"].n == 1
    for edges in ([1.0], [1.0, 1.0], [2.0, 1.0]):
        with pytest.raises(InputError, match="increasing"):
            strata(np.zeros(1), edges)


def test_speeds_and_standing_persons() -> None:
    object_id = np.array([[0, -1, 1], [1, 1, 0]])
    speeds = beam_speeds(object_id, np.array([[0.0, 1.2], [0.5, 0.05]]))
    np.testing.assert_array_equal(speeds, [[0.0, math.nan, 1.2], [0.05, 0.05, 0.5]])
    masks = motion_strata(speeds)
    assert masks["standing"].tolist() == [[True, False, False], [True, True, False]]
    assert masks["walking"].tolist() == [[False, False, True], [False, False, True]]
    assert np.isnan(beam_speeds(np.full((2, 3), -1), np.zeros((2, 0)))).all()
    with pytest.raises(InputError, match="object 1 has no speed"):
        beam_speeds(object_id, np.zeros((2, 1)))


def test_distance_to_the_nearest_wall() -> None:
    p = np.full((3, 4), 0.1)
    p[1, 2], p[0, 0] = 0.9, math.nan
    grid = GridMap(p_occupied=p, resolution_m=0.5, origin=np.array([-1.0, 2.0]))
    points = np.array([[[0.25, 2.75], [0.25, 4.75]], [[-2.75, 2.75], [math.nan, 0.0]]])
    np.testing.assert_allclose(distance_to_wall(points, grid), [[0.0, 2.0], [3.0, math.nan]])
    empty = GridMap(p_occupied=np.zeros((2, 2)), resolution_m=0.5, origin=np.zeros(2))
    assert distance_to_wall(np.zeros((1, 2)), empty).tolist() == [math.inf]


def test_shapes_must_agree() -> None:
    with pytest.raises(InputError, match="one shape"):
        evaluate_points(bits("11"), bits("111"))
