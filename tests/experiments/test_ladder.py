"""The ladder goes from the paper's method to ours, one change a preset."""

from dataclasses import fields
from itertools import pairwise

from experiments.ladder import presets
from slammot_graph.localization.config import ScanToLocalMapConfig, ScanToMapConfig, ScanToScanConfig
from slammot_graph.methods import METHODS


def test_the_ladder_begins_at_docpfo_and_ends_at_graph() -> None:
    found = presets()
    assert found[0].config == METHODS["docpfo"].config
    assert found[-1].config == METHODS["graph"].config
    assert len({preset.name for preset in found}) == len(found) == 12


def test_each_rung_changes_one_part_but_for_the_one_that_brings_the_graph() -> None:
    for before, after in pairwise(presets()):
        changed = {
            f.name
            for f in fields(before.config)
            if getattr(before.config, f.name) != getattr(after.config, f.name)
        }
        assert len(changed) == (3 if after.name == "pose graph" else 1), after.name


def test_localizers_come_in_their_order() -> None:
    kinds = [type(preset.config.localizer) for preset in presets()]
    assert kinds == [ScanToScanConfig, *[ScanToLocalMapConfig] * 6, *[ScanToMapConfig] * 5]
