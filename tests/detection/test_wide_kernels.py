import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.detection import _wide_kernels
from slammot_graph.detection.clustering import ClusterConfig
from slammot_graph.detection.reasons import (
    ALONG,
    DISCARDED,
    FREE,
    NOT_VALID,
    OCCUPIED,
    TOO_WIDE,
    TRACKED,
    UNKNOWN,
    VACATED,
)
from tests.detection.test_cluster_kernels import connected, random_limits, random_points, seeds


def plain_wide(
    points: FloatArray, is_valid: BoolArray, mapped_share: float, reason: IntArray, config: ClusterConfig
) -> IntArray:
    """Reasons where discarded beams of groups that are too wide are told apart."""
    is_member = np.isin(reason, (DISCARDED, FREE, VACATED, TRACKED, ALONG))
    out = reason.copy()
    if np.count_nonzero(is_member) <= mapped_share * np.count_nonzero(is_valid):
        return out
    labels = connected(points, is_member, config.max_gap_m, config.max_skipped_beams)
    for c in range(labels.max(initial=-1) + 1):
        beams = np.flatnonzero(labels == c)
        if (np.ptp(points[beams], axis=0) > [config.max_x_range_m, config.max_y_range_m]).any():
            out[beams[reason[beams] == DISCARDED]] = TOO_WIDE
    return out


@settings(max_examples=150)
@given(seeds, st.booleans())
def test_what_is_too_wide_is_told_apart_as_its_twin_does(seed: int, is_exact: bool) -> None:
    rng = np.random.default_rng(seed)
    points, is_valid = random_points(rng, 50, is_exact), rng.random(50) < 0.9
    codes = (OCCUPIED, UNKNOWN, FREE, VACATED, DISCARDED)
    reason = np.where(is_valid, rng.choice(codes, 50, p=[0.2, 0.1, 0.2, 0.1, 0.4]), NOT_VALID)
    config, share = random_limits(rng), float(rng.choice([0.2, 0.75]))
    expected = plain_wide(points, is_valid, share, reason, config)
    _wide_kernels.mark_wide(
        points,
        is_valid,
        share,
        config.max_gap_m,
        config.max_skipped_beams,
        config.max_x_range_m,
        config.max_y_range_m,
        reason,
    )
    np.testing.assert_array_equal(reason, expected)
