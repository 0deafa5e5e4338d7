import math

import numpy as np
import pytest

from slammot_graph.core.errors import InputError
from slammot_graph.evaluation import TrackPoints, evaluate_tracks

EMPTY = TrackPoints(
    frames=np.zeros(0, dtype=np.int64), ids=np.zeros(0, dtype=np.int64), positions=np.zeros((0, 2))
)


def scenario(seed: int) -> tuple[TrackPoints, TrackPoints]:
    """Four walkers, tracks that miss, swap, break and are false."""
    rng = np.random.default_rng(seed)
    truth, tracks = [], []
    positions, velocities = rng.uniform(-2, 2, (4, 2)), rng.normal(0, 0.15, (4, 2))
    ids = np.array([10, 20, 30, 40])
    for frame in range(40):
        positions = positions + velocities
        if frame % 9 == 8:
            a, b = rng.choice(4, 2, replace=False)
            ids[[a, b]] = ids[[b, a]]
        if frame % 15 == 14:
            ids[rng.integers(4)] = 100 + frame
        for k in range(4):
            if frame < 5 * k:
                continue
            truth.append((frame, k + 1, *positions[k]))
            if rng.random() < 0.8:
                tracks.append((frame, ids[k], *(positions[k] + rng.normal(0, 0.18, 2))))
        if rng.random() < 0.3:
            tracks.append((frame, 500 + frame // 7, *rng.uniform(-2, 2, 2)))
    return track_points(truth), track_points(tracks)


def track_points(rows: list[tuple[float, ...]]) -> TrackPoints:
    table = np.array(rows)
    return TrackPoints(
        frames=table[:, 0].astype(np.int64), ids=table[:, 1].astype(np.int64), positions=table[:, 2:]
    )


@pytest.mark.parametrize(
    ("seed", "mota", "n_switches", "idf1", "hota", "det_a", "ass_a"),
    [
        (0, 0.5692307692, 10, 0.4710743802, 0.3496039869, 0.5248413800, 0.2337627702),
        (1, 0.6538461538, 7, 0.6080000000, 0.4552011299, 0.5820474106, 0.3565064833),
        (2, 0.6230769231, 8, 0.6419753086, 0.4533848146, 0.5254334548, 0.3915341159),
    ],
)
def test_scores_agree_with_trackeval(
    seed: int, mota: float, n_switches: int, idf1: float, hota: float, det_a: float, ass_a: float
) -> None:
    """Figures of trackeval 1.3.0 (MOTA, switches, HOTA and its parts) and motmetrics 1.4.0 (IDF1)."""
    scores = evaluate_tracks(*scenario(seed), max_distance_m=0.5)
    assert scores.n_switches == n_switches
    assert scores.mota == pytest.approx(mota)
    assert scores.idf1 == pytest.approx(idf1)
    assert scores.hota == pytest.approx(hota)
    assert scores.det_a == pytest.approx(det_a)
    assert scores.ass_a == pytest.approx(ass_a)
    assert scores.n == scores.n_matches + scores.n_misses
    assert scores.n_estimates == scores.n_matches + scores.n_false


def test_perfect_tracks() -> None:
    truth, _ = scenario(0)
    renamed = TrackPoints(frames=truth.frames, ids=truth.ids + 70, positions=truth.positions)
    scores = evaluate_tracks(truth, renamed)
    assert (scores.mota, scores.idf1) == (1.0, 1.0)
    assert scores.hota == pytest.approx(1.0)
    assert (scores.position_rmse_m, scores.n_switches) == (0.0, 0)


def test_position_error_and_misses() -> None:
    truth = track_points([(0, 1, 0, 0), (1, 1, 1, 0), (2, 1, 2, 0)])
    tracks = track_points([(0, 5, 0.3, 0), (1, 5, 1.0, 0.1), (2, 5, 2.0, 0.6)])
    scores = evaluate_tracks(truth, tracks, max_distance_m=0.5)
    assert scores.position_rmse_m == pytest.approx(math.sqrt((0.09 + 0.01) / 2))
    assert (scores.n_matches, scores.n_misses, scores.n_false) == (2, 1, 1)
    assert scores.mota == pytest.approx(1 / 3)


def test_empty_sets() -> None:
    truth, tracks = scenario(0)
    nothing = evaluate_tracks(EMPTY, EMPTY)
    false_only = evaluate_tracks(EMPTY, tracks)
    for scores in (nothing, false_only):
        assert scores.n == 0
        for score in (scores.mota, scores.idf1, scores.hota, scores.position_rmse_m):
            assert math.isnan(score)
    assert false_only.n_false == len(tracks.ids)
    missed = evaluate_tracks(truth, EMPTY)
    assert (missed.mota, missed.idf1, missed.hota) == (0.0, 0.0, 0.0)
    assert math.isnan(missed.position_rmse_m)


def test_misuse_is_a_clear_error() -> None:
    with pytest.raises(InputError, match="twice in one frame"):
        track_points([(0, 1, 0, 0), (0, 1, 1, 0)])
    with pytest.raises(InputError, match="one id and one position"):
        TrackPoints(
            frames=np.zeros(2, dtype=np.int64), ids=np.zeros(1, dtype=np.int64), positions=np.zeros((2, 2))
        )
    with pytest.raises(InputError, match="positive"):
        evaluate_tracks(EMPTY, EMPTY, max_distance_m=0.0)
