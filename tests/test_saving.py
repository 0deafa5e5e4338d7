"""A result is saved as a run folder and loaded again."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from slammot_graph import InputError, Run, RunResult, load_run
from slammot_graph.core.log_info import LogInfo
from slammot_graph.core.types import FloatArray
from tests.rooms import drive


@cache
def result() -> RunResult:
    return Run(drive(20)).complete()


def test_what_was_saved_is_loaded(tmp_path: Path) -> None:
    result().save(tmp_path / "deep" / "run")
    assert (tmp_path / "deep" / "run" / "overview.png").stat().st_size > 1000
    run = load_run(tmp_path / "deep" / "run")
    assert (run.method, run.log) == ("graph", Path.cwd() / "list.log")
    np.testing.assert_allclose(run.stamps, result().stamps, atol=1e-9)
    np.testing.assert_allclose(run.T_map_base, result().T_map_base, atol=1e-8)
    np.testing.assert_array_equal(run.cov_map, result().cov_map)
    assert run.points is not None
    for name in ("is_valid", "is_moving", "is_moving_online", "p_moving"):
        np.testing.assert_array_equal(getattr(run.points, name), getattr(result(), name))
    np.testing.assert_allclose(run.tracks, result().tracks[:, :9], rtol=1e-8)
    assert run.summary["n_scans_of_log"] == 20
    assert run.summary["config"] == result().config


def test_a_saved_run_is_replaced_only_when_asked(tmp_path: Path) -> None:
    result().save(tmp_path)
    (tmp_path / "run.rrd").write_bytes(b"of the earlier run")
    with pytest.raises(InputError, match="overwrite=True"):
        result().save(tmp_path)
    replace(result(), method="another").save(tmp_path, overwrite=True)
    assert load_run(tmp_path).method == "another"
    assert not (tmp_path / "run.rrd").exists()


@pytest.mark.parametrize("log", ["some folder/some.bag", None])
def test_the_picture_names_the_log(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, log: str | None) -> None:
    names = []

    def draw(drawn: RunResult, path: Path, *, log_name: str | None, moving_points: FloatArray) -> None:
        names.append(log_name)
        assert moving_points is drawn.moving_points
        path.touch()

    monkeypatch.setattr("slammot_graph.viz.overview.draw_overview", draw)
    replace(result(), log=LogInfo(path=None if log is None else Path(log))).save(tmp_path)
    assert names == [None if log is None else "some.bag"]
