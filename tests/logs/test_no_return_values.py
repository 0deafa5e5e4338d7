import numpy as np
import pytest

from slammot_graph.core.scan import LaserModel
from slammot_graph.core.types import FloatArray
from slammot_graph.logs.no_return_values import NoReturnValues

LASER = LaserModel(angle_min=-1.57, angle_increment=0.0174, n_beams=181, range_min=0.05, range_max=30.0)


def room(
    seed: int, *, reach_m: float = np.inf, code_m: float = np.inf, resolution_m: float = 0.01
) -> FloatArray:
    """A corner of a room in centimetres, seen by a laser with a reach."""
    angles = LASER.angle_min + LASER.angle_increment * np.arange(LASER.n_beams)
    with np.errstate(divide="ignore"):
        ranges = np.minimum(3.0 / np.abs(np.sin(angles)), 5.0 / np.abs(np.cos(angles)))
    ranges = ranges + np.random.default_rng(seed).normal(0.0, 0.003, len(ranges))
    ranges = np.round(ranges / resolution_m) * resolution_m
    return np.where(ranges > reach_m, code_m, ranges)


def test_a_room_has_no_such_number() -> None:
    found = NoReturnValues()
    for seed in range(20):
        ranges = room(seed)
        assert found.cleared(ranges, LASER) is ranges
    assert found.warnings() == []


@pytest.mark.parametrize("code_m", [4.0, 8.19])
def test_a_number_for_no_return_is_found_and_kept(code_m: float) -> None:
    found = NoReturnValues()
    told = room(0, reach_m=4.0, code_m=code_m)
    cleared = found.cleared(told, LASER)
    np.testing.assert_array_equal(cleared, np.where(told == code_m, np.inf, told))
    assert 0 < np.isinf(cleared).sum() < len(cleared)
    few = np.full(LASER.n_beams, 2.0) + 0.01 * np.arange(LASER.n_beams) % 1.0
    few[7] = code_m
    assert np.isinf(found.cleared(few, LASER)).sum() == 1
    (warning,) = found.warnings()
    assert f"exactly {code_m:g} m" in warning


def test_farther_returns_show_that_it_was_none() -> None:
    found = NoReturnValues()
    found.cleared(room(0, reach_m=4.0, code_m=4.0), LASER)
    ranges = room(1)
    ranges[3] = 4.0
    assert found.cleared(ranges, LASER) is ranges


def test_what_lies_beyond_the_limits_is_none_of_it() -> None:
    found = NoReturnValues()
    for code_m in (0.0, 30.0, 65.535, np.inf, np.nan):
        ranges = room(0, reach_m=4.0, code_m=code_m)
        assert found.cleared(ranges, LASER) is ranges
