"""Runs that go on from a kept state: the same result as without the interruption, bit by bit."""

from dataclasses import fields, replace

import numpy as np
import pytest

from slammot_graph.core.errors import InputError
from slammot_graph.core.frozen_state import FrozenRun
from slammot_graph.core.results import RunResult
from slammot_graph.core.saved_map import MapStart
from slammot_graph.core.spool import Spool
from slammot_graph.localization import ScanToMapConfig
from slammot_graph.localization.scan_to_map import ScanToMap
from slammot_graph.loop_closure import place_finder
from slammot_graph.methods import Config, get_method
from slammot_graph.pipeline import Pipeline
from slammot_graph.run import Run
from tests.rooms import ListLog, drive, kidnapped, pipeline_config

OF_TIME = {"stage_ms"}


def kept(frozen: FrozenRun) -> FrozenRun:
    """The state as it comes out of a file: its spools go on growing."""
    copies = []
    for spool in frozen.spools:
        copies.append(Spool(1 << 20))
        copies[-1].add(spool.since(0))
    return replace(frozen, spools=tuple(copies))


def assert_same(one: RunResult, other: RunResult) -> None:
    for name in (field.name for field in fields(RunResult)):
        if name in OF_TIME:
            continue
        a, b = getattr(one, name), getattr(other, name)
        if isinstance(a, np.ndarray):
            assert a.dtype == b.dtype, name
            np.testing.assert_array_equal(a, b, err_msg=name)
        elif name == "grid":
            np.testing.assert_array_equal(a.p_occupied, b.p_occupied)
        elif name in ("edges", "saved_map"):
            assert len(repr(a)) == len(repr(b))
        else:
            assert repr(a) == repr(b), name


def frozen_at(
    log: ListLog, method: str, numbers: list[int], config: Config | None = None
) -> tuple[list[FrozenRun], RunResult]:
    run, states = Run(log, method, config=config), []
    for number, _ in enumerate(run, start=1):
        if number in numbers:
            states.append(kept(run.freeze()))
    return states, run.result()


@pytest.mark.parametrize("method", ["graph", "docpfo", "icp", "odometry"])
def test_a_run_goes_on_as_if_nothing_had_been(method: str) -> None:
    log = drive(60)
    states, whole = frozen_at(log, method, [1, 23, 59, 60])
    for state in states:
        assert state.state is not None
        run = Run(log, method)
        run.resume(state)
        steps = list(run)
        assert [step.scan.index for step in steps] == list(range(state.n_scans, 60))
        assert_same(run.result(), whole)


def test_a_lost_robot_goes_on_too() -> None:
    log = kidnapped(drive(40), 25)
    config = replace(pipeline_config("graph"), localizer=ScanToMapConfig(n_lost=3))
    states, whole = frozen_at(log, "graph", [20, 27, 35], config)
    assert "lost" in {event.kind for event in whole.events}
    for state in states:
        run = Run(log, config=config)
        run.resume(state)
        assert_same(run.complete(), whole)


@pytest.mark.parametrize("localize", [True, False])
def test_a_run_from_a_saved_map_goes_on(localize: bool) -> None:
    log = drive(80)
    saved = Run(log).complete().saved_map
    assert saved is not None
    start = MapStart(saved=saved, localize=localize)
    run, states = Run(log, start=start), []
    for number, _ in enumerate(run, start=1):
        if number in (5, 50):
            states.append(kept(run.freeze()))
    for state in states:
        other = Run(log, start=start)
        other.resume(state)
        assert_same(other.complete(), run.result())
    with pytest.raises(InputError, match="is of another start in a saved map"):
        Run(log).resume(states[0])


def test_a_run_goes_on_in_the_midst_of_a_search(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(place_finder, "N_AT_ONCE", 1)
    log = drive(80)
    saved = Run(log).complete().saved_map
    assert saved is not None
    start = MapStart(saved=saved, localize=False)
    run, states = Run(log, start=start), []
    for _ in run:
        assert isinstance(run.pipeline, Pipeline)
        localizer = run.pipeline.localizer
        assert isinstance(localizer, ScanToMap)
        assert localizer.closer is not None
        assert localizer.closer.finder is not None
        if localizer.closer.finder.is_searching:
            states.append(kept(run.freeze()))
    assert states
    for state in states[:3]:
        assert state.state is not None
        other = Run(log, start=start)
        other.resume(state)
        assert_same(other.complete(), run.result())


def test_a_run_goes_on_twice() -> None:
    log = drive(40)
    (first,), whole = frozen_at(log, "graph", [10])
    run, second = Run(log), None
    run.resume(first)
    for step in run:
        if step.scan.index == 24:
            second = kept(run.freeze())
    assert second is not None
    assert second.n_scans == 25
    last = Run(log)
    last.resume(second)
    assert_same(last.complete(), whole)


def test_a_method_whose_state_cannot_be_kept_does_all_again() -> None:
    log = drive(12)
    (state,), whole = frozen_at(log, "kiss-icp", [8])
    assert state.state is None
    run = Run(log, "kiss-icp")
    run.resume(state)
    assert len(list(run)) == 12
    np.testing.assert_allclose(run.result().T_map_base, whole.T_map_base, atol=1e-6)
    other = Run(drive(12, seed=5), "kiss-icp")
    other.resume(state)
    with pytest.raises(InputError, match="are not those of the checkpoint"):
        other.complete()


def test_another_method_configuration_or_log_is_refused() -> None:
    log = drive(12)
    (state,), _ = frozen_at(log, "graph", [8])
    with pytest.raises(InputError, match="is of another method"):
        Run(log, "icp").resume(state)
    with pytest.raises(InputError, match="is of other settings"):
        Run(log, config=replace(get_method("graph").config, max_range_m=7.0)).resume(state)
    with pytest.raises(InputError, match="is of another version"):
        Run(log).resume(replace(state, fingerprint={**state.fingerprint, "versions": "numpy 1"}))
    for other in (ListLog(log.scans[1:]), ListLog(log.scans[:5]), drive(12, seed=7)):
        run = Run(other)
        run.resume(state)
        with pytest.raises(InputError, match="are not those of the checkpoint"):
            run.complete()
