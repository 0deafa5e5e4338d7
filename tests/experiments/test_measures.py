"""Scores of trajectories."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from experiments import measures


def straight(length_m: float) -> Any:
    x = np.linspace(0.0, length_m, 41)
    return SimpleNamespace(T_map_base=np.column_stack([x, np.zeros(41), np.zeros(41)]))


def test_an_error_over_a_metre_is_a_share_of_it() -> None:
    # the estimate is 2% too long: 4 m become 4.08 m, a metre of the truth 1.02 m, up to the spacing of the poses
    scores = measures.trajectory_scores(straight(4.08), straight(4.0).T_map_base)
    assert scores["rpe_m"] == pytest.approx(0.02, rel=0.05)
    assert scores["rpe_deg"] == pytest.approx(0.0, abs=1e-6)


def test_a_drive_of_less_than_a_metre_has_no_error_over_a_metre() -> None:
    scores = measures.trajectory_scores(straight(0.51), straight(0.5).T_map_base)
    assert 0.0 < scores["ate_m"] < 0.01
    assert math.isnan(scores["rpe_m"])
    assert math.isnan(scores["rpe_deg"])
