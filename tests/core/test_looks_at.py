"""Where a scan looks: the beams' field of view, their reach, and what occludes."""

import math

import numpy as np
import pytest

from slammot_graph.core.scan import LaserModel, Scan


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_looks_at(sense: float) -> None:
    laser = LaserModel(
        angle_min=-sense * math.pi / 2,
        angle_increment=sense * math.pi / 180,
        n_beams=181,
        range_min=0.1,
        range_max=10.0,
        T_base_laser=(-0.5, 0.0, math.pi),
    )
    ranges = np.full(181, np.inf)
    ranges[90] = 3.0
    ranges[0 if sense > 0 else 180] = np.nan
    scan = Scan(index=0, stamp=0.0, ranges=ranges, laser=laser, T_odom_base=None)
    places = np.array(
        [[-2.0, 0.0], [-3.8, 0.0], [-5.0, 0.0], [2.0, 0.0], [-2.0, 2.0], [-20.0, 9.0], [-0.5, 3.0]]
    )
    # before, a little behind and far behind a return; out of view; past no return; out of reach; a beam without range
    assert scan.looks_at(places).tolist() == [True, True, False, False, True, False, False]
