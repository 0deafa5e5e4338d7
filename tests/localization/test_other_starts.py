import numpy as np

from slammot_graph.core import se2
from slammot_graph.localization import ScanToMapConfig
from slammot_graph.localization.other_starts import (
    MOST,
    N_SEARCHED,
    leads,
    shifted_starts,
    some_of,
    turned_starts,
)

FIRST = np.array([2.0, -1.0, 0.7])
CONFIG = ScanToMapConfig()


def test_starts_are_turned_either_way_in_steps() -> None:
    turns = [se2.between(FIRST, T) for T in turned_starts(FIRST, 0.3, 0.35, 1.0)]
    np.testing.assert_allclose(turns, [[0, 0, 0.6], [0, 0, -0.6], [0, 0, 0.9], [0, 0, -0.9]], atol=1e-12)


def test_starts_are_shifted_on_a_grid_within_reach_in_all_headings() -> None:
    offsets = np.array([se2.between(FIRST, T) for T in shifted_starts(FIRST, 0.5, 1.2, 1.0)])
    places = np.unique(np.round(offsets[:, :2], 6), axis=0)
    assert len(places) == 13  # of the 5 x 5 grid those within two steps
    assert len(offsets) == 13 * 7  # as it is, and turned by 1, 2 and 3 rad either way
    assert np.hypot(*places.T).max() <= 1.2


def test_some_are_valid_and_from_all_over_the_scan() -> None:
    is_valid = np.arange(1000) >= 100
    some = some_of(is_valid)
    assert not (some & ~is_valid).any()
    assert N_SEARCHED <= some.sum() <= 1.1 * N_SEARCHED
    assert np.diff(np.flatnonzero(some)).max() == 15
    np.testing.assert_array_equal(some_of(np.arange(20) < 7), np.arange(20) < 7)


def test_a_pose_leads_that_far_more_agree_with_than_with_any_other() -> None:
    near = se2.compose(FIRST, np.array([0.5 * CONFIG.adrift_m, 0.0, 0.0]))
    far = se2.compose(FIRST, np.array([0.0, 2.0 * CONFIG.adrift_m, 0.0]))
    turned = se2.compose(FIRST, np.array([0.0, 0.0, 1.5 * CONFIG.turn_step_rad]))
    best, rival = (0.9, FIRST), 0.9 / CONFIG.astray_lead
    assert leads(best, [best, (0.89, near), (rival - 0.01, far)], 0.1, 0.9, CONFIG)
    assert not leads(best, [best, (rival + 0.01, far)], 0.1, 0.9, CONFIG)
    assert not leads(best, [best, (rival + 0.01, turned)], 0.1, 0.9, CONFIG)
    assert not leads(best, [best], rival + 0.01, 0.9, CONFIG)
    assert not leads((MOST - 0.01, FIRST), [(MOST - 0.01, FIRST)], 0.0, 0.1, CONFIG)
    assert not leads((0.6, FIRST), [(0.6, FIRST)], 0.0, 0.9, CONFIG)
