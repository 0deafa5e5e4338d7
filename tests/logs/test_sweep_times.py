"""Beam times of a sweeping laser, and those that cannot be right."""

from pathlib import Path

import numpy as np
import pytest

from slammot_graph.core.scan import LaserModel
from slammot_graph.logs import open_log, write_npz_log
from slammot_graph.logs.sweep_times import sweep_times

LASER = LaserModel(
    angle_min=-3.14, angle_increment=2 * np.pi / 360, n_beams=360, range_min=0.1, range_max=12.0
)
STAMPS = 0.2 * np.arange(20.0)


def test_beam_times_are_those_of_the_increment() -> None:
    found = sweep_times(0.0005, STAMPS, LASER, "here")
    assert found.beam_times is not None and not found.warnings
    np.testing.assert_allclose(found.beam_times, 0.0005 * np.arange(360))


def test_zero_is_a_snapshot() -> None:
    found = sweep_times(0.0, STAMPS, LASER, "here")
    assert found.beam_times is None and not found.warnings


@pytest.mark.parametrize(
    ("increment", "words"),
    [(0.5, "longer than"), (-0.0005, "negative"), (np.nan, "not finite"), (np.inf, "not")],
)
def test_what_cannot_be_right_is_told_and_replaced(increment: float, words: str) -> None:
    found = sweep_times(increment, STAMPS, LASER, "time_increment of /scan")
    assert found.beam_times is not None
    np.testing.assert_allclose(found.beam_times[-1], 0.2 * 359 / 360)
    (warning,) = found.warnings
    assert "time_increment of /scan" in warning and words in warning and "correct the driver" in warning


def test_without_a_period_the_beams_count_as_sent_out_at_once() -> None:
    found = sweep_times(-0.1, STAMPS[:1], LASER, "here")
    assert found.beam_times is None and "at once" in found.warnings[0]


def write(path: Path, time_increment: float | None) -> None:
    write_npz_log(
        path,
        stamps=STAMPS,
        ranges=np.full((20, 360), 2.0),
        angle_min=LASER.angle_min,
        angle_increment=LASER.angle_increment,
        range_min=0.1,
        range_max=12.0,
        time_increment=time_increment,
    )


def test_npz_logs_keep_it(tmp_path: Path) -> None:
    write(tmp_path / "a.npz", 0.0005)
    scans = list(open_log(tmp_path / "a.npz"))
    assert scans[0].beam_times is not None and scans[0].beam_times is scans[1].beam_times
    np.testing.assert_allclose(scans[0].beam_times, 0.0005 * np.arange(360))
    write(tmp_path / "b.npz", None)
    assert next(iter(open_log(tmp_path / "b.npz"))).beam_times is None


def test_npz_logs_warn_of_a_wrong_one(tmp_path: Path) -> None:
    write(tmp_path / "a.npz", 0.1)
    log = open_log(tmp_path / "a.npz")
    assert any("time_increment" in warning for warning in log.warnings)
