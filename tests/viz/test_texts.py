from dataclasses import replace

import numpy as np

from slammot_graph.core.findings import Finding
from slammot_graph.run import Run
from slammot_graph.viz.rerun.texts import summary_text
from tests.rooms import drive


def test_the_summary_tells_the_verdict_and_the_scans_that_are_not_healthy() -> None:
    result = Run(drive(12)).complete()
    good = summary_text(result)
    assert "Verdict" not in good
    assert "healthy" not in good
    finding = Finding(kind="clock offset", severity="warning", cause="the clocks differ", remedy="set them")
    health = np.array([*["healthy"] * 9, *["lost"] * 3])
    text = summary_text(replace(result, verdict=(finding,), health=health))
    assert "| lost | 3 scans |" in text
    assert text.endswith("## Verdict\n- warning: the clocks differ; set them")
