"""Crowds by JuPedSim, where it is installed; a clear line where it is not."""

import sys

import numpy as np
import pytest

from slammot_graph.core.errors import ConfigError
from slammot_graph.simulation import simulate
from slammot_graph.simulation.worlds import world_named


def test_without_the_library_the_remedy_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "jupedsim", None)
    with pytest.raises(ConfigError, match=r"slammot-graph\[crowds\]"):
        simulate("crowd", seed=0, n_people=3)


def test_a_crowd_walks_on_free_ground_and_clear_of_the_robot() -> None:
    pytest.importorskip("jupedsim", reason="crowds need the extra: pip install slammot-graph[crowds]")
    log = simulate("crowd", seed=1, n_people=8, rate_hz=5.0)
    positions = log.objects[:, :, :2]
    assert np.isfinite(positions).all()
    assert (world_named("hall").free_space.clearance_at(positions) > 0.2).mean() > 0.99
    distance = np.linalg.norm(positions - log.T_world_base[:, None, :2], axis=2)
    assert distance.min() > 0.7
    assert log.is_moving.any()
