import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slammot_graph.core.errors import ConfigError
from slammot_graph.core.scan import LaserModel, Scan


def laser(**changes: object) -> LaserModel:
    values: dict[str, object] = {
        "angle_min": -math.pi / 2,
        "angle_increment": math.pi / 2,
        "n_beams": 3,
        "range_min": 0.1,
        "range_max": 10.0,
    }
    return LaserModel(**(values | changes))  # type: ignore[arg-type]


def scan(ranges: list[float], model: LaserModel | None = None) -> Scan:
    model = model or laser(n_beams=len(ranges))
    return Scan(index=0, stamp=1.0, ranges=np.array(ranges), laser=model, T_odom_base=np.zeros(3))


def test_end_points_of_known_beams() -> None:
    points = scan([1.0, 2.0, 3.0]).points_base()
    np.testing.assert_allclose(points, [[0, -1], [2, 0], [0, 3]], atol=1e-12)


def test_mounting_shifts_and_turns_the_beams() -> None:
    model = laser(T_base_laser=(0.5, 0.1, math.pi / 2))
    points = scan([1.0, 2.0, 3.0], model).points_base()
    np.testing.assert_allclose(points, [[1.5, 0.1], [0.5, 2.1], [-2.5, 0.1]], atol=1e-12)
    np.testing.assert_allclose(model.origin_base, [0.5, 0.1])


def test_points_are_carried_into_another_frame() -> None:
    points = scan([1.0, 2.0, 3.0]).points(np.array([10.0, 0.0, math.pi]))
    np.testing.assert_allclose(points, [[10, 1], [8, 0], [10, -3]], atol=1e-12)


def test_no_return_nan_negative_and_too_near_are_not_points() -> None:
    ranges = [math.nan, math.inf, -math.inf, -1.0, 0.0, 0.1, 0.11, 9.69, 9.7, 10.0, 81.9]
    expected = [False, False, False, False, False, False, True, True, False, False, False]
    assert scan(ranges).is_valid().tolist() == expected
    assert scan(ranges).is_valid(max_range=5.0).tolist() == [i == 6 for i in range(11)]


SPECIAL = [0.0, 1e-3, 0.1, 4.9, 5.0, 9.7, 9.8, 9.9, 10.0, math.nan, math.inf, -math.inf]


@given(
    ranges=st.lists(st.floats(), max_size=8),
    range_min=st.sampled_from([0.0, 1e-3, 0.1, 5.0]),
    max_range=st.sampled_from([math.inf, 9.9, 9.7, 5.0, 0.1, 0.0]),
)
def test_points_lie_between_the_limits_and_on_neither(
    ranges: list[float], range_min: float, max_range: float
) -> None:
    measured = scan([*ranges, *SPECIAL], laser(n_beams=len(ranges) + len(SPECIAL), range_min=range_min))
    is_above = measured.ranges > max(range_min, 1e-3)
    is_below = (measured.ranges < 0.97 * 10.0) & (measured.ranges < max_range)
    np.testing.assert_array_equal(measured.is_valid(max_range), is_above & is_below)


def test_zero_range_is_never_a_point() -> None:
    assert not scan([0.0], laser(n_beams=1, range_min=0.0)).is_valid().any()


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"n_beams": 0}, "at least one beam"),
        ({"angle_min": math.nan}, "not finite"),
        ({"angle_increment": 0.0}, "angle_increment is zero"),
        ({"range_min": -0.1}, "range_min"),
        ({"range_max": 0.05}, "range_max"),
        ({"range_max": math.nan}, "range_max"),
    ],
)
def test_impossible_lasers_are_refused(changes: dict[str, object], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        laser(**changes)


@pytest.mark.parametrize(
    "pose", [(np.nan, 0.0, 0.0), (0.0, -120.0, 0.0), (1e200, 0.0, 0.0), (0.0, 0.0, np.inf)]
)
def test_a_laser_far_off_its_robot_is_refused(pose: tuple[float, float, float]) -> None:
    with pytest.raises(ConfigError, match="out of any sense"):
        LaserModel(
            angle_min=0.0, angle_increment=0.1, n_beams=3, range_min=0.1, range_max=9.0, T_base_laser=pose
        )
