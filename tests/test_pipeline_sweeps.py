"""The whole step on a laser that sweeps."""

from dataclasses import replace
from itertools import islice

import numpy as np

from slammot_graph.core import se2
from slammot_graph.pipeline import Pipeline, PipelineConfig
from slammot_graph.simulation import simulate
from slammot_graph.simulation.scenarios import scenario_named


def test_a_sweep_that_turns_is_mapped_as_a_snapshot_is() -> None:
    """At 7 Hz and up to 1.5 rad/s a wall 5 m away is bent by 1 m; nobody is about, so whatever moves is wrong."""
    scenario = replace(scenario_named("fast-turns"), world="lab", n_people=0)
    log = simulate(scenario, seed=1)
    n, n_moving, config = 150, 0, PipelineConfig()
    with Pipeline(config) as pipeline:
        for scan in islice(log, n):
            step = pipeline.step(scan)
            n_moving += int(np.count_nonzero(step.is_moving))
            assert not step.tracks
            assert (step.scan.sweep is not None) and step.scan.origins_base.shape == (360, 2)
        final = pipeline.final()
        labels = pipeline.final_labels(final.T_map_base)
    truth = se2.between(log.T_world_base[0], log.T_world_base[:n])
    errors = se2.between(final.T_map_base, truth)
    assert np.abs(np.diff(truth[:, 2])).max() > 0.15
    assert np.hypot(errors[:, 0], errors[:, 1]).max() < 0.05 and np.abs(errors[:, 2]).max() < 0.01
    assert labels is not None and sum(np.count_nonzero(label) for label in labels) < 60
    assert n_moving < 60
