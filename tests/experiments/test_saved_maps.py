"""The experiment on saved maps: what counts as found, in time, inside and wrong."""

import numpy as np

from experiments.saved_maps import _starts_row


def start(**changed: float) -> dict[str, float]:
    one = {"is_inside": 1.0, "is_found": 1.0, "seen_m": 2.0, "way_m": 2.0}
    return one | {"error_m": 0.02, "error_deg": 0.2, "step_max_ms": 100.0} | changed


def test_starts_are_counted() -> None:
    nan = float(np.nan)
    starts = [
        start(),
        start(seen_m=7.0),
        start(is_found=0.0, seen_m=15.0, error_m=nan, error_deg=nan),
        start(is_inside=0.0, error_m=3.0),
    ]
    row = _starts_row("intel", starts)
    assert row[:6] == ["intel", "4", "3", "1", "1", "1"]
    assert row[-1] == "100"
