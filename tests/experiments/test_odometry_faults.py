"""The experiment on faults of the odometry: its quick mode, what it needs by the truth, and what counts as said."""

from pathlib import Path

import numpy as np
import pytest

from experiments.faults import FAULTS, NONE
from experiments.odometry_faults import (
    FIRST_SEED,
    QUICK_FAULTS,
    FaultOptions,
    cell,
    expected,
    is_silent,
    key,
    main,
)
from experiments.tables import provenance
from slammot_graph.core.types import FloatArray
from slammot_graph.simulation import SimulatedLog, simulate
from slammot_graph.simulation.robot import OdometryNoise, simulate_odometry


@pytest.fixture(scope="module")
def lab() -> SimulatedLog:
    return simulate("lab", seed=FIRST_SEED, rate_hz=5.0, n_laps=1)


def with_noise(log: SimulatedLog, **stds: float) -> SimulatedLog:
    """The log with odometry that has these errors only."""
    none = dict.fromkeys(OdometryNoise.__dataclass_fields__, 0.0)
    noise = OdometryNoise(**{**none, **stds})
    T_odom_base, _ = simulate_odometry(log.T_world_base, noise, np.random.default_rng(1))
    return log.with_odometry(T_odom_base)


def test_quick_mode(tmp_path: Path) -> None:
    arguments = ["--quick", "--jobs", "1", "--output", str(tmp_path)]
    assert main(arguments) == 0
    text = (tmp_path / "tables" / "odometry_faults.md").read_text(encoding="utf-8")
    assert "Quick mode" in text
    assert "`python -m experiments.odometry_faults --quick --jobs 1`" in text
    assert "nan" not in text.lower()
    blocks = [block for block in text.split("\n\n") if block.startswith("|")]
    assert len(blocks) == 3
    for block in blocks:
        lines = block.splitlines()
        assert len({line.count("|") for line in lines}) == 1, block
        faults = [line.split(" | ")[0].strip("| ") for line in lines[2:]]
        assert faults == [name for name in QUICK_FAULTS if len(lines) == 6 or FAULTS[name].is_steady]
    results = (tmp_path / "results" / "odometry_faults.jsonl").read_text(encoding="utf-8")
    assert len(results.splitlines()) == 2 * len(QUICK_FAULTS)
    assert main(arguments) == 0  # finished cells are read, not run again
    assert (tmp_path / "results" / "odometry_faults.jsonl").read_text(encoding="utf-8") == results


def test_the_command_names_the_scenarios_that_are_not_all() -> None:
    options = FaultOptions(scenarios=("lab", "hall"), seeds=20, jobs=1)
    command = provenance("odometry_faults", options)[0]
    assert command == (
        "- Command: `python -m experiments.odometry_faults --seeds 20 --scenarios lab hall --jobs 1`"
    )


@pytest.mark.parametrize("name", list(FAULTS))
def test_each_fault_changes_the_odometry(name: str, lab: SimulatedLog) -> None:
    changed = FAULTS[name].apply(lab)
    is_same = np.allclose(changed.T_odom_base, lab.T_odom_base)
    assert is_same == (name == NONE)
    assert np.isfinite(changed.T_odom_base).all()


@pytest.mark.parametrize("name", [name for name, fault in FAULTS.items() if fault.is_steady])
def test_what_is_needed_mends_the_odometry(name: str, lab: SimulatedLog) -> None:
    """The odometry with the fault, corrected by what it is said to need, is the truth again."""
    clean = with_noise(lab, scale_std=0.02, turn_scale_std=0.03, bias_std_rad_per_m=0.02)
    fault = FAULTS[name]
    needed = expected(clean, fault)
    assert needed["clock_offset_s"] == fault.delay_s
    told, true = motion(fault.apply(clean).T_odom_base), motion(clean.T_world_base)
    metres = told[0] * needed["distance_scale"]
    turn = told[1] * needed["heading_scale"] + told[0] * needed["heading_bias_rad_per_m"]
    assert metres == pytest.approx(true[0], rel=0.01)
    assert turn == pytest.approx(true[1], abs=0.05)


def motion(T: FloatArray) -> tuple[float, float]:
    """Metres driven and turn of a whole trajectory (n, 3)."""
    turn = np.unwrap(T[:, 2])
    return float(np.hypot(*np.diff(T[:, :2], axis=0).T).sum()), float(turn[-1] - turn[0])


def test_a_run_that_is_wrong_has_to_say_so() -> None:
    quiet = {
        "verdict": [], "n_contradictions": 0, "n_lost": 0, "relative sigmas": 3.0, "map sigmas": 4.0,
    }  # fmt: skip
    assert not is_silent(quiet)
    wrong = {**quiet, "map sigmas": 6.0}
    assert is_silent(wrong)
    assert is_silent({**quiet, "relative sigmas": 6.0})
    assert not is_silent({**wrong, "verdict": ["odometry jumps"]})
    assert not is_silent({**wrong, "n_contradictions": 1})
    assert not is_silent({**wrong, "n_lost": 1})


def test_cells_have_names_of_their_own() -> None:
    keys = {
        key("lab", seed, fault, method) for seed in (1, 11) for fault in FAULTS for method in ("graph", "x")
    }
    assert len(keys) == 4 * len(FAULTS)


def test_an_unknown_scenario_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--quick", "--scenarios", "cellar", "--jobs", "1", "--output", str(tmp_path)]
    assert main(arguments) == 2
    assert 'no scenario "cellar"' in capsys.readouterr().err


def test_a_baseline_is_scored_by_its_error_alone() -> None:
    scores = cell("lab", FIRST_SEED, "never moves", "odometry")
    assert set(scores) == {"ate_m", "max_m"}
    assert scores["ate_m"] > 0.5
