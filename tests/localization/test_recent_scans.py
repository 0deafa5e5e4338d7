import math

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.localization.recent_scans import LEAP_M, N_LEAPS, REACH, RecentScans

FIRST, SECOND = np.array([1.0, 2.0, 0.3]), np.array([1.2, 2.1, 0.4])


def after(*poses: FloatArray, most_change_m: float = math.inf) -> RecentScans:
    recent = RecentScans()
    for T in poses:
        recent.start_scan(T, has_odometry=True, most_change_m=most_change_m)
    return recent


def test_it_starts_where_the_robot_was_and_where_its_motion_leads() -> None:
    here, ahead = after(FIRST, SECOND).starts()
    np.testing.assert_array_equal(here, SECOND)
    np.testing.assert_allclose(se2.between(SECOND, ahead), se2.between(FIRST, SECOND))


@pytest.mark.parametrize("share", [0.5, 2.0])
def test_the_farthest_is_what_was_driven_lately_or_is_told(share: float) -> None:
    step = se2.between(FIRST, SECOND)
    way_m, turn_rad = after(FIRST, SECOND).farthest(se2.compose(SECOND, share * step))
    assert way_m == pytest.approx(REACH * max(share, 1.0) * np.hypot(*step[:2]))
    assert turn_rad == pytest.approx(REACH * max(share, 1.0) * 0.1)


def leaps(*offsets_m: float) -> list[bool]:
    """Whether each of some matches so far ahead of their predictions, one a scan, is out of reach."""
    recent, out = after(FIRST, most_change_m=0.15), []
    for offset_m in offsets_m:
        recent.start_scan(SECOND, has_odometry=True, most_change_m=0.15)
        out.append(recent.is_out_of_reach(SECOND, se2.compose(SECOND, np.array([offset_m, 0.0, 0.0]))))
    return out


def test_a_match_out_of_reach_is_believed_once_others_confirm_it() -> None:
    held = (N_LEAPS - 1) * [True]
    assert leaps(0.14, 0.15) == [False, False]
    assert leaps(*(N_LEAPS + 1) * (0.3,)) == [*held, False, False]
    assert leaps(*np.arange(0.3, 0.3 + 5.5 * LEAP_M, LEAP_M)) == 6 * [True]
    assert leaps(0.3, 0.3, 0.0, 0.3) == [True, True, False, True]


def test_without_odometry_nothing_is_out_of_reach() -> None:
    assert not after(FIRST, SECOND).is_out_of_reach(SECOND, np.array([40.0, 0.0, 0.0]))
