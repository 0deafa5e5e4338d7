"""Final labels by the final tracks: what no track goes through must have been sure at the time."""

from dataclasses import replace

import numpy as np
import pytest

from slammot_graph.core.types import FloatArray
from slammot_graph.detection.clustering import ClusterConfig
from slammot_graph.detection.scan_history import ScanRecord
from slammot_graph.detection.untracked import REACH_M, without_untracked
from tests.detection.test_furniture import LEG, record
from tests.rooms import is_person

POSES = np.zeros((3, 3))
NOWHERE = np.empty((0, 2))


def records(*, is_sure: bool) -> list[ScanRecord]:
    seen = [record(k, sees_leg=k == 1) for k in range(3)]
    return [replace(item, is_sure=np.full_like(item.is_valid, is_sure)) for item in seen]


@pytest.mark.parametrize(
    ("places", "scan", "is_sure", "is_kept"),
    [
        (NOWHERE, 1, False, False),
        (NOWHERE, 1, True, True),
        (np.array([LEG[:2]]), 1, False, True),
        (np.array([LEG[:2]]), 2, False, False),  # at another scan
        (np.array([[LEG[0], LEG[1] + REACH_M + 0.2]]), 1, False, False),
    ],
)
def test_what_no_track_goes_through_must_have_been_sure(
    places: FloatArray, scan: int, is_sure: bool, is_kept: bool
) -> None:
    history = records(is_sure=is_sure)
    labels = [is_person(item.scan) for item in history]
    assert labels[1].any()
    kept = without_untracked(
        labels,
        history,
        POSES,
        clusters=ClusterConfig(),
        track_scans=np.full(len(places), scan),
        track_places=places,
    )
    assert [mask.any() for mask in kept] == [False, is_kept, False]
    if is_kept:
        np.testing.assert_array_equal(kept[1], labels[1])
