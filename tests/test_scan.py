import math

import numpy as np
import pytest

from slammot_graph.errors import ConfigError
from slammot_graph.scan import LaserModel, Scan


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
