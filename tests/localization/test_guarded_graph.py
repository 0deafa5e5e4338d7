"""What must not enter the pose graph is dropped with an event, and the run goes on."""

import numpy as np
import pytest

from slammot_graph import Run
from slammot_graph.core.types import FloatArray
from slammot_graph.graph import PoseGraph
from tests.rooms import drive, errors


@pytest.mark.parametrize("kind", ["match", "odometry"])
@pytest.mark.parametrize("damage", ["T", "information"])
def test_a_run_goes_on_without_a_bad_factor(monkeypatch: pytest.MonkeyPatch, kind: str, damage: str) -> None:
    plain = Run(drive(40)).complete()
    add_edge = PoseGraph.add_edge
    n_bad = 0

    def sometimes_bad(
        graph: PoseGraph, what: str, a: int, b: int, T: FloatArray, information: FloatArray
    ) -> object:
        nonlocal n_bad
        if what == kind and b == 2 and not n_bad:
            n_bad += 1
            T, information = (np.full(3, np.nan), information) if damage == "T" else (T, -information)
        return add_edge(graph, what, a, b, T, information)  # type: ignore[arg-type]

    monkeypatch.setattr(PoseGraph, "add_edge", sometimes_bad)
    result = Run(drive(40)).complete()
    dropped = [event for event in result.events if event.kind == "factor dropped"]
    assert [event.data["factor"] for event in dropped] == [kind]
    assert not result.failures
    assert max(errors(result.T_map_base, plain.T_map_base)) < 0.05
