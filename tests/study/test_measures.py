"""What a cell of a study measures."""

import math
from pathlib import Path

import pytest

from slammot_graph.core.errors import InputError, SlammotError
from slammot_graph.core.results import RunResult
from slammot_graph.evaluation import absolute_error, evaluate_points
from slammot_graph.methods import METHODS
from slammot_graph.run import Run
from slammot_graph.run_folder.tum import write_trajectory
from slammot_graph.simulation import simulate
from slammot_graph.study.measures import completed, config_of, config_text, recorded_cell, simulated_cell


@pytest.mark.parametrize("name", METHODS)
def test_a_configuration_comes_back(name: str) -> None:
    assert config_of(config_text(METHODS[name].config)) == METHODS[name].config


def test_a_simulated_cell_is_a_run_judged_by_its_truth() -> None:
    scores = simulated_cell("one-walker", 0, config_text(METHODS["docpfo"].config), {"rate_hz": 5.0})
    log = simulate("one-walker", seed=0, rate_hz=5.0)
    result = Run(log, "docpfo").complete()
    assert scores["ate_m"] == absolute_error(result.T_map_base, log.T_world_base).translation_m.rmse
    assert scores["iou"] == evaluate_points(result.is_moving, log.is_moving, result.is_valid).iou
    assert scores["n_scans"] == log.n_scans
    assert all(isinstance(value, int | float) for value in scores.values())
    assert scores["ghosts_per_m2"] >= 0.0


def test_a_recorded_cell_is_judged_by_what_is_known(tmp_path: Path) -> None:
    log = simulate("one-walker", seed=1, rate_hz=5.0, n_people=0)
    log.write(tmp_path / "log.npz")
    write_trajectory(tmp_path / "true.tum", log.stamps, log.T_world_base)
    path, config = str(tmp_path / "log.npz"), config_text(METHODS["icp"].config)
    plain = recorded_cell(path, config, max_scans=50)
    assert plain == {"n_scans": 50, "n_closures": 0, "n_failed_matches": plain["n_failed_matches"]}
    judged = recorded_cell(path, config, max_scans=50, truth=str(tmp_path / "true.tum"))
    assert 0.0 < judged["ate_m"] < 0.1
    people = recorded_cell(
        path, config, seed=3, people=2, max_scans=50, trajectory=str(tmp_path / "true.tum")
    )
    assert "iou" in people
    assert "ate_m" not in people  # the poses that people are put in at are no truth
    assert not math.isnan(people["recall"])
    with pytest.raises(InputError, match="at the poses of a trajectory"):
        recorded_cell(path, config, people=2)


def test_a_map_that_fails_at_the_end_fails_no_cell(monkeypatch: pytest.MonkeyPatch) -> None:
    class Fails(Run):
        def complete(self) -> RunResult:
            super().complete()
            raise SlammotError("no map")

    log = simulate("one-walker", seed=1, rate_hz=5.0, n_people=0)
    assert len(completed(Fails(log, "odometry")).stamps) == log.n_scans
    run = Fails(log, "odometry")
    monkeypatch.setattr(Fails, "is_complete", False)
    with pytest.raises(SlammotError, match="no map"):
        completed(run)
