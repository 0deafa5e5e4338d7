"""What a run keeps of its steps comes back as it was, from memory or from the disk."""

import numpy as np
import pytest

from slammot_graph import kept_scans
from slammot_graph.kept_scans import KeptScans
from slammot_graph.run import Run
from tests.rooms import drive


@pytest.mark.parametrize("most_in_memory", [1 << 20, 500])
def test_what_is_kept_comes_back(monkeypatch: pytest.MonkeyPatch, most_in_memory: int) -> None:
    monkeypatch.setattr(kept_scans, "MOST_IN_MEMORY", most_in_memory)
    steps = list(Run(drive(40)))
    kept = KeptScans()
    for step in steps:
        kept.keep(step)
    rows = kept.rows()
    assert len(kept) == len(rows) == 40
    np.testing.assert_array_equal(rows["index"], range(40))
    np.testing.assert_array_equal(rows["cov_map"], [step.cov_map for step in steps])
    np.testing.assert_array_equal(rows["T_odom_base"], [step.scan.T_odom_base for step in steps])
    assert kept.health().tolist() == [step.health for step in steps]
    is_valid, is_moving, p_moving = kept.beams()
    np.testing.assert_array_equal(is_valid, [step.is_valid for step in steps])
    np.testing.assert_array_equal(is_moving, [step.is_moving for step in steps])
    np.testing.assert_array_equal(p_moving, np.array([s.p_moving for s in steps], dtype=np.float16))
    T_map_base = rows["T_map_base"]
    expected = [s.scan.points(T)[s.is_moving] for s, T in zip(steps, T_map_base, strict=True)]
    np.testing.assert_allclose(kept.moving_points(T_map_base), np.concatenate(expected), atol=1e-5)
    np.testing.assert_array_equal(kept.online_estimate().T_map_base, T_map_base)
    assert set(kept.stage_ms()) == {name for step in steps for name in step.stage_ms}
    assert all(len(times) == 40 for times in kept.stage_ms().values())
    kept.close()


def test_nothing_is_kept_of_nothing() -> None:
    kept = KeptScans()
    assert [array.shape for array in kept.beams()] == [(0, 0)] * 3
    assert kept.online_estimate().T_map_base.shape == (0, 3)
    assert kept.moving_points(np.empty((0, 3))).shape == (0, 2)
