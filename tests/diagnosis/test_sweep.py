"""When a laser sends out its beams: found where it turns, where the log may tell wrong, and only then."""

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from slammot_graph.core.errors import InputError
from slammot_graph.core.scan import Scan
from slammot_graph.diagnosis.checking import check_log
from slammot_graph.diagnosis.sweep import (
    Sweep,
    _assumptions,
    _lead,
    _may_be_wrong,
    find_sweeps,
    with_found_sweeps,
)
from slammot_graph.evaluation import absolute_error
from slammot_graph.logs import open_log
from slammot_graph.logs.arrays import write_npz_log
from slammot_graph.logs.source import LaserLog
from slammot_graph.run import Run
from slammot_graph.simulation import SimulatedLog, simulate

PERIOD_S, N_SCANS = 1.0 / 7.0, 240


@lru_cache(maxsize=2)
def drive(sweep: float) -> SimulatedLog:
    return simulate("fast-turns", seed=31, laser="lowcost360", sweep=sweep)


def log_of(
    path: Path,
    *,
    sweep: float,
    told_s: float,
    is_reversed: bool = False,
    n_scans: int = N_SCANS,
    n_beams: int | None = None,
) -> LaserLog:
    """A log that tells of a sweep of so long [s]; reversed: its beams are listed against their order."""
    log = drive(sweep)
    arrays = {key: x[:n_scans] if np.shape(x)[:1] == (log.n_scans,) else x for key, x in log.arrays().items()}
    n_beams = n_beams or log.laser.n_beams
    arrays["ranges"] = arrays["ranges"][:, :n_beams]
    if is_reversed:
        arrays["ranges"] = arrays["ranges"][:, ::-1]
        last = arrays["angle_min"] + (n_beams - 1) * arrays["angle_increment"]
        arrays |= {"angle_min": last, "angle_increment": -arrays["angle_increment"]}
    for key in ("is_moving", "object_id"):
        del arrays[key]
    arrays["time_increment"] = told_s / (n_beams - 1)
    write_npz_log(path, **arrays)
    return open_log(path)


def error_m(log: LaserLog) -> float:
    result = Run(log).complete()
    return absolute_error(result.T_map_base, drive(1.0).T_world_base[:N_SCANS]).translation_m.rmse


@pytest.mark.parametrize(
    ("told_s", "is_reversed"), [(0.0, False), (PERIOD_S / 1000.0, True), (PERIOD_S, True)]
)
def test_a_sweep_that_the_log_tells_wrong_is_found(tmp_path: Path, told_s: float, is_reversed: bool) -> None:
    log = log_of(tmp_path / "log.npz", sweep=1.0, told_s=told_s, is_reversed=is_reversed)
    right = log_of(tmp_path / "right.npz", sweep=1.0, told_s=PERIOD_S)
    used = with_found_sweeps(log)
    times = next(iter(used)).beam_times
    assert times is not None
    ends = (times[-1], times[0]) if is_reversed else (times[0], times[-1])
    np.testing.assert_allclose(ends, (0.0, PERIOD_S), atol=0.01 * PERIOD_S)
    (told,) = used.warnings
    assert "which is used instead" in told
    assert ("from the last beam to the first, which" in told) is is_reversed
    assert error_m(log) < 1.5 * error_m(right)


@pytest.mark.parametrize(("sweep", "told_s"), [(0.0, 0.0), (1.0, PERIOD_S)])
def test_what_is_told_rightly_stays(tmp_path: Path, sweep: float, told_s: float) -> None:
    log = log_of(tmp_path / "log.npz", sweep=sweep, told_s=told_s)
    assert with_found_sweeps(log) is log


def test_so_do_simulations_in_memory_and_lasers_that_do_not_look_all_round(tmp_path: Path) -> None:
    assert with_found_sweeps(drive(1.0)) is drive(1.0)
    log = log_of(tmp_path / "log.npz", sweep=1.0, told_s=0.0, n_beams=270)
    assert with_found_sweeps(log) is log


def test_a_laser_that_looks_farther_than_all_round_is_not_searched() -> None:
    """Its angles are in degrees, and no sweep makes sense of them."""
    scan = next(iter(drive(0.0)))
    assert _may_be_wrong(scan, has_own_times=False)
    in_degrees = replace(scan.laser, angle_increment=float(np.degrees(scan.laser.angle_increment)))
    assert not _may_be_wrong(replace(scan, laser=in_degrees), has_own_times=False)


def test_snapshots_that_are_told_as_a_sweep_are_found(tmp_path: Path) -> None:
    log = log_of(tmp_path / "log.npz", sweep=0.0, told_s=PERIOD_S, n_scans=400)
    assert next(iter(with_found_sweeps(log))).beam_times is None


def test_check_tells_of_it_too(tmp_path: Path) -> None:
    report = check_log(log_of(tmp_path / "log.npz", sweep=1.0, told_s=0.0))
    assert "beam times" in [finding.kind for finding in report.verdict]


def test_scans_without_stamps_tell_nothing() -> None:
    scans = list(drive(1.0))[:200]
    for scan in scans:
        object.__setattr__(scan, "stamp", 0.0)
    assert find_sweeps(scans) == {}


def test_a_log_that_cannot_be_read_to_its_end_is_left_to_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = log_of(tmp_path / "log.npz", sweep=1.0, told_s=0.0)
    read = type(log).__iter__

    def damaged(self: LaserLog) -> Iterator[Scan]:
        yield from islice(read(self), 50)
        raise InputError("damaged")

    monkeypatch.setattr(type(log), "__iter__", damaged)
    assert with_found_sweeps(log) is log


def test_a_warning_of_the_log_gives_way_to_what_was_found(tmp_path: Path) -> None:
    log = log_of(tmp_path / "log.npz", sweep=1.0, told_s=3.0 * PERIOD_S, is_reversed=True)
    assert len(log.warnings) == 1
    (told,) = with_found_sweeps(log).warnings
    assert "which is used instead" in told


def test_what_may_be() -> None:
    whole = Sweep(duration_s=0.1)
    backward = Sweep(duration_s=0.1, is_reversed=True)
    turn_rad = 2.0 * np.pi
    assert _assumptions(Sweep(), 0.1, turn_rad) == [Sweep(), whole, backward]
    assert _assumptions(Sweep(duration_s=1e-4), 0.1, turn_rad) == [Sweep(duration_s=1e-4), whole, backward]
    assert _assumptions(whole, 0.1, turn_rad) == [whole, backward, Sweep()]


def test_a_lead_stands_out_of_noise_only_where_it_is_there() -> None:
    rng = np.random.default_rng(0)
    sigmas = [_lead(rng.normal(size=60), np.zeros(60))[1] for _ in range(500)]
    assert np.percentile(np.abs(sigmas), 99) < 4.0
    gain, sigma = _lead(rng.normal(0.03, 0.02, size=60), np.zeros(60))
    assert gain == pytest.approx(0.03, abs=0.01)
    assert sigma > 5.0
    assert _lead(np.ones(5), np.ones(5)) == (0.0, 0.0)
