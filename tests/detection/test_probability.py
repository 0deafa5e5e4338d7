import math

import numpy as np
import pytest

from slammot_graph.core.types import FloatArray
from slammot_graph.detection import reasons
from slammot_graph.detection.base import Detection
from slammot_graph.detection.probability import (
    MAX_RANGE_M,
    NAMES,
    SHARE_OF_STATIC,
    WEIGHTS,
    cluster_evidence,
    probability_of_moving,
)
from slammot_graph.mapping.occupancy_grid import GridConfig, OccupancyGrid

NOWHERE = np.empty((0, 2))


def detection_of(cluster: list[int], reason: list[int]) -> Detection:
    labels = np.array(cluster)
    return Detection(
        is_moving=labels >= 0,
        reason=np.array(reason),
        cluster=labels,
        n_clusters=int(labels.max(initial=-1)) + 1,
        packed_cov=np.zeros((len(labels), 3)),
    )


def grid_seen(times: int, points: FloatArray) -> OccupancyGrid:
    """Each point was crossed so many times by beams from the origin that ended a metre behind it."""
    grid = OccupancyGrid(GridConfig(), window_m=60.0)
    far = points * (1.0 + 1.0 / np.hypot(*points.T))[:, None]
    for now in range(times):
        grid.update(now, np.zeros(2), far, np.ones(len(far), np.bool_), np.ones(len(far), np.bool_))
    return grid


def test_evidence_as_computed_one_by_one(rng: np.random.Generator) -> None:
    points = rng.uniform(1.0, 3.0, (30, 2)) * rng.choice([1.0, 6.0], (30, 1))
    ranges = np.hypot(*points.T)
    cluster = rng.integers(-1, 4, 30)
    reason = np.where(cluster < 0, reasons.OCCUPIED, rng.choice([reasons.FREE, reasons.VACATED], 30))
    grid = grid_seen(3, points[::2])
    expected = points[cluster == 1].mean(axis=0)[None] + 0.3
    found = cluster_evidence(detection_of(cluster.tolist(), reason.tolist()), points, ranges, grid, expected)
    for c in range(4):
        of = cluster == c
        i, j = np.floor(points[of][:, ::-1] * grid.inv_resolution).astype(int).T & (len(grid.log_odds) - 1)
        log_odds = np.where(grid.stamp[i, j] >= grid.oldest, grid.log_odds[i, j], 0.0)
        width = math.hypot(*(points[of].max(axis=0) - points[of].min(axis=0)))
        is_expected = math.dist(expected[0], points[of].mean(axis=0)) < 0.6
        twin = [
            1.0,
            math.log(of.sum()),
            min(ranges[of].mean(), MAX_RANGE_M),
            (reason[of] != reasons.FREE).mean(),
            float(not (reason[of] == reasons.FREE).any()),
            max(log_odds.mean() - grid.l_min, 0.0),
            math.log(1.0 + width),
            float(is_expected),
        ]
        np.testing.assert_allclose(found[c], twin, rtol=1e-5, atol=1e-6)
    assert len(NAMES) == len(WEIGHTS) == found.shape[1]


def test_cells_seen_free_often_make_it_surer() -> None:
    points = np.array([[2.0, 0.02 * k] for k in range(8)])
    detection = detection_of([0] * 8, [reasons.FREE] * 8)
    ranges = np.hypot(*points.T)
    p = [
        probability_of_moving(detection, points, ranges, grid_seen(times, points), NOWHERE)[0]
        for times in (1, 3, 10)
    ]
    assert p[0] < p[1] <= p[2]
    assert p[2] > 0.9


@pytest.mark.parametrize("reason", list(SHARE_OF_STATIC))
def test_points_called_static_have_the_share_of_their_like(reason: int) -> None:
    detection = detection_of([-1, -1], [reason, reasons.NOT_VALID])
    points = np.array([[1.0, 1.0], [2.0, 2.0]])
    p = probability_of_moving(detection, points, np.ones(2), grid_seen(1, points), NOWHERE)
    assert p[0] == SHARE_OF_STATIC[reason]
    assert np.isnan(p[1])


def test_every_reason_has_a_probability_or_is_of_moving_points() -> None:
    moving = {reasons.FREE, reasons.TRACKED, reasons.VACATED, reasons.ALONG, reasons.NOT_VALID}
    assert set(SHARE_OF_STATIC) | moving == set(range(len(reasons.REASONS)))
    assert all(0.0 <= share <= 1.0 for share in SHARE_OF_STATIC.values())
