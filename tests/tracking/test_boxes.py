"""Boxes of vehicles after the run."""

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.tracking.base import ScanView
from slammot_graph.tracking.boxes import box_centre, headings, laid_in_box
from slammot_graph.tracking.chain import Chain, SmoothingConfig

LENGTH, WIDTH = 0.8, 0.3


@pytest.mark.parametrize(
    ("laser", "low", "high", "centre"),
    [
        ((5.0, 0.0), (0.3, -0.1), (0.4, 0.1), (0.0, 0.0)),  # its front alone
        ((-5.0, 0.0), (-0.4, -0.1), (-0.4, 0.1), (0.0, 0.0)),  # its rear alone
        ((0.0, 3.0), (-0.4, 0.1), (0.4, 0.1), (0.0, 0.0)),  # its left side
        (
            (0.0, 3.0),
            (-0.2, 0.1),
            (0.4, 0.1),
            (0.1, 0.0),
        ),  # a part of that, which does not tell where it goes on
    ],
)
def test_a_box_is_laid_against_the_side_that_is_seen(
    laser: tuple[float, float],
    low: tuple[float, float],
    high: tuple[float, float],
    centre: tuple[float, float],
) -> None:
    found = box_centre(np.array(low), np.array(high), np.array(laser), np.array([0.8, 0.2]))
    np.testing.assert_allclose(found, centre, atol=1e-12)


def test_who_stands_has_the_heading_of_the_nearest_drive() -> None:
    states = np.zeros((30, 4))
    states[5:17, 3] = 1.0
    found = headings(states)
    assert found is not None
    np.testing.assert_allclose(found, 0.5 * np.pi)
    assert headings(np.zeros((30, 4))) is None


def seen_of(box: FloatArray, laser: FloatArray) -> FloatArray:
    """Points of the sides of a box (3,) that look at a laser."""
    x, y = np.linspace(-0.5 * LENGTH, 0.5 * LENGTH, 21), np.linspace(-0.5 * WIDTH, 0.5 * WIDTH, 9)
    side = se2.transform(se2.inverse(box), laser[None])[0]
    points = [np.column_stack([x, np.full(21, np.copysign(0.5 * WIDTH, side[1]))])]
    if abs(side[0]) > 0.5 * LENGTH:
        points.append(np.column_stack([np.full(9, np.copysign(0.5 * LENGTH, side[0])), y]))
    else:
        points = points[:1]
    if abs(side[1]) <= 0.5 * WIDTH:
        points = points[1:]
    return np.asarray(se2.transform(box, np.concatenate(points)))


def test_a_car_that_drives_by_is_not_pulled_to_the_near_side() -> None:
    n = 80
    stamps: FloatArray = np.linspace(0.0, 0.1 * (n - 1), n)
    laser = np.array([0.0, -0.1, 0.0])
    truth = np.column_stack([np.linspace(-4.0, 4.0, n), np.full(n, 0.9), np.zeros(n)])
    truth[:20, 1] = truth[20, 1]
    seen = [seen_of(box, laser[:2]) for box in truth]
    view = ScanView(
        points=np.empty((0, 2)), packed_cov=np.empty((0, 3)), cluster=np.empty(0, dtype=np.int64),
        is_proven=np.empty(0, dtype=np.bool_), T_local_laser=laser, angle_min=0.0, angle_increment=0.01,
        ranges=np.empty(0), is_valid=np.empty(0, dtype=np.bool_), no_return_m=10.0,
    )  # fmt: skip
    chain = Chain(
        scans=np.arange(n),
        places=np.array([points.mean(axis=0) for points in seen]),
        covs=np.tile(0.01 * np.eye(2), (n, 1, 1)),
        sizes=np.full(n, LENGTH),
        thickness=np.full(n, 0.01),
    )
    before = np.hypot(*(chain.places - truth[:, :2]).T)
    boxed, size = laid_in_box(chain, [(points, view) for points in seen], stamps, SmoothingConfig())
    after = np.hypot(*(boxed.places - truth[:, :2]).T)
    np.testing.assert_allclose(size, [LENGTH, WIDTH], atol=0.06)
    assert before.mean() > 0.12
    assert after.mean() < 0.05
