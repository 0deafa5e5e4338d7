"""Beside vacated places: what is more probably something that comes into view is not called moving."""

import numpy as np
import pytest

from slammot_graph.detection.base import Detection
from slammot_graph.detection.reasons import FREE, OCCUPIED, TRACKED, UNKNOWN, VACATED
from slammot_graph.detection.unlikely import is_crowded, without_unlikely

REASON = np.array([OCCUPIED, VACATED, VACATED, OCCUPIED, VACATED, FREE, TRACKED, VACATED, UNKNOWN])
CLUSTER = np.array([-1, 0, 0, -1, 1, 1, 2, 3, -1])
FLAT = np.full(len(REASON), 5.0)


def detection() -> Detection:
    return Detection(
        is_moving=CLUSTER >= 0,
        reason=REASON,
        cluster=CLUSTER,
        n_clusters=4,
        packed_cov=np.zeros((len(REASON), 3)),
    )


def test_only_improbable_clusters_without_free_cells_are_dropped() -> None:
    p = np.array([np.nan, 0.1, 0.1, 0.0, 0.1, 0.1, 0.1, 0.9, 0.0])
    found = without_unlikely(detection(), FLAT, p, 0.2)
    np.testing.assert_array_equal(found.cluster, [-1, -1, -1, -1, 0, 0, 1, 2, -1])
    np.testing.assert_array_equal(found.is_moving, found.cluster >= 0)
    np.testing.assert_array_equal(found.reason[1:3], UNKNOWN)
    np.testing.assert_array_equal(found.reason[3:], REASON[3:])
    assert found.n_clusters == 3


def test_probable_ones_stay_as_they_are() -> None:
    whole = detection()
    assert without_unlikely(whole, FLAT, np.full(len(REASON), 0.5), 0.2) is whole


@pytest.mark.parametrize(("share", "is_crowd"), [(0.6, True), (0.7, False)])
def test_a_crowd_is_where_much_of_the_scan_moves(share: float, is_crowd: bool) -> None:
    assert is_crowded(detection(), np.full(len(REASON), True), share) == is_crowd


@pytest.mark.parametrize(
    ("aside_m", "is_kept"), [((5.0, 5.0), False), ((8.0, 5.0), False), ((8.0, np.inf), True)]
)
def test_what_stands_free_before_what_is_behind_it_stays(aside_m: tuple[float, float], is_kept: bool) -> None:
    ranges = FLAT.copy()
    ranges[[0, 3]] = aside_m
    found = without_unlikely(detection(), ranges, np.zeros(len(REASON)), 0.2)
    assert (found.cluster[1] == 0) == is_kept
