from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from slammot_graph.core.scan import Scan
from slammot_graph.core.sweep import SweepMotion
from slammot_graph.detection import reasons, scan_history
from slammot_graph.detection.scan_history import ScanHistory
from tests.rooms import take_scan


def judged_scans(rng: np.random.Generator, n: int) -> list[dict[str, Any]]:
    items = []
    for k in range(n):
        scan = take_scan(np.array([2.0, 0.5, 0.1 * k]))
        scan.ranges[::7] = [np.nan, np.inf, 0.0][k % 3]
        n_beams = len(scan.ranges)
        items.append(
            {
                "scan": Scan(
                    index=3 + k,
                    stamp=0.1 * k,
                    ranges=scan.ranges,
                    laser=scan.laser,
                    T_odom_base=scan.T_odom_base,
                ),
                "is_valid": rng.random(n_beams) < 0.4,
                "is_moving": rng.random(n_beams) < 0.4,
                "reason": rng.integers(0, len(reasons.REASONS), n_beams),
                "marks": rng.random((3, n_beams)) < 0.1,
                "cov_relative": np.diag([1e-5, 2e-5, 3e-6]),
                "window": k // 2,
                "is_doubtful": k == 3,
            }
        )
    return items


@pytest.mark.parametrize("most_in_memory", [1 << 20, 3000])
def test_what_is_kept_comes_back_as_it_was(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, most_in_memory: int
) -> None:
    monkeypatch.setattr(scan_history, "MOST_IN_MEMORY", most_in_memory)
    kept, items = ScanHistory(), judged_scans(rng, 12)
    for k, item in enumerate(items):
        kept.append(**item)
        assert kept[k // 2].scan.index == 3 + k // 2  # reading in between does no harm
    assert len(kept) == 12
    for item, back in zip(items, kept, strict=True):
        np.testing.assert_array_equal(back.is_valid, item["is_valid"])
        np.testing.assert_array_equal(back.is_moving, item["is_moving"])
        np.testing.assert_array_equal(back.is_wall, item["reason"] == reasons.OCCUPIED)
        np.testing.assert_array_equal(back.is_displaced, item["marks"][0])
        np.testing.assert_array_equal(back.is_lasting, item["marks"][1])
        np.testing.assert_array_equal(back.is_sure, item["marks"][2])
        np.testing.assert_allclose(back.scan.ranges, item["scan"].ranges, rtol=1e-6)
        np.testing.assert_allclose(back.cov_relative, item["cov_relative"], rtol=1e-6)
        assert (back.window, back.is_doubtful) == (item["window"], item["is_doubtful"])
        assert (back.scan.index, back.scan.stamp) == (item["scan"].index, item["scan"].stamp)
        assert back.scan.laser is item["scan"].laser
    assert [item.window for item in kept[1:3]] == [0, 1]
    kept.close()


def test_no_scan_is_lost_with_the_temporary_file(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(**_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(scan_history, "MOST_IN_MEMORY", 2000)
    monkeypatch.setattr("tempfile.TemporaryFile", full)
    kept, items = ScanHistory(), judged_scans(rng, 8)
    for item in items:
        kept.append(**item)
    for item, back in zip(items, kept, strict=True):
        np.testing.assert_array_equal(back.is_moving, item["is_moving"])
    assert "No space left on device" in caplog.text
    assert "TMPDIR" in caplog.text
    assert len(caplog.records) < 8  # not at every scan
    kept.close()


def test_a_deskewed_scan_keeps_its_sweep(rng: np.random.Generator) -> None:
    kept, items = ScanHistory(), judged_scans(rng, 4)
    times = 0.001 * np.arange(len(items[0]["scan"].ranges))
    for k, item in enumerate(items):
        knots = rng.normal(0.0, 0.1, (9, 3))
        sweep = SweepMotion(
            first_s=0.0, last_s=float(times[-1]), T_stamp_base=knots, cov_velocity=np.diag([0.1, 0.2, 0.3])
        )
        if k % 2:
            item["scan"] = replace(item["scan"], beam_times=times, sweep=sweep)
        kept.append(**item)
    for item, back in zip(items, kept, strict=True):
        sweep, kept_sweep = item["scan"].sweep, back.scan.sweep
        assert (sweep is None) == (kept_sweep is None)
        np.testing.assert_allclose(back.scan.points_base(), item["scan"].points_base(), atol=1e-5)
        np.testing.assert_allclose(back.scan.origins_base, item["scan"].origins_base, atol=1e-6)
        np.testing.assert_array_equal(back.is_valid, item["is_valid"])
        if sweep is not None and kept_sweep is not None:
            np.testing.assert_allclose(kept_sweep.cov_velocity, sweep.cov_velocity, rtol=1e-6)
    kept.close()
