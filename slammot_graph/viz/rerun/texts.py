"""The texts of a recording: events, the state of the match, legend, configuration and summary."""

from collections.abc import Iterator, Mapping
from typing import Any, get_args

import numpy as np

from slammot_graph.core.events import Severity
from slammot_graph.core.results import Health, RunResult, StepResult
from slammot_graph.viz.rerun.columns import Columns, times_of

LEVELS: Mapping[Severity, str] = {"info": "INFO", "warning": "WARN", "error": "ERROR"}
"""Log level of an event of each severity."""

LEGEND = """
| in the map | |
|---|---|
| white to grey, black | free, the whiter the surer; occupied |
| grey-green | not known |
| small dark points | what the graph's nodes saw lately, also where the map is not yet drawn |
| blue points | the scan's static points |
| amber points | static by the decision, though `p_moving` is above one half |
| red points, red ellipses | points that move, with the 95% covariance that the test used |
| light red points | those of the last scans |
| pale green, tan, lilac squares | around moving points: free, occupied, unknown cells of the test's own grid |
| | as the scan before left them, so the test saw them; in the view of the scan only |
| thin blue ellipses | the same covariance of every tenth static point |
| blue line | the path through the graph's nodes as they are now |
| thin blue line, dark blue ellipse | each scan's place as it was estimated then, 95% of the robot's position |
| dark blue dot on the path | the scan that the local map is attached to |
| orange line | raw odometry, started at the same place |
| green line | truth, where it is known |
| points with arrows | tracks with their velocity and 95% ellipse, numbered where there is room |
| pink lines | loop closures of the graph |
| green, amber, red lines | those just accepted, waiting, rejected as outliers, for some scans |
| grey lines | those last refused, hidden unless you switch `closures/refused` on |
| brown line | for some scans: the graph before a closure |

Zoom in on a red ellipse in the scan's view to see the cells that it covers. Click a point, or an ellipse, twice to
read its `beam`, `p_moving`, the `reason` of the decision and the semi-axes of its 95% ellipse; click a loop closure to
read why. The panel for it opens with the button at the top right.
"""


class TextPanel:
    """Events, and the states of the match and of the localization where they change."""

    def __init__(self, out: Columns) -> None:
        self._out = out
        self._states = {"match": "", "health": ""}

    def send(self, steps: list[StepResult]) -> None:
        """Send events, and the states where they change."""
        import rerun as rr

        times = times_of(steps)
        row_of = [row for row, step in enumerate(steps) for _ in step.events]
        if row_of:
            events = [event for step in steps for event in step.events]
            texts = [f"scan {event.scan}: {event.text}" for event in events]  # the view cuts its own column
            levels = [LEVELS[event.severity] for event in events]
            self._out.send("/log/events", times[row_of], rr.TextLog.columns(text=texts, level=levels))
        matches = ["none" if step.match is None else step.match.status for step in steps]
        for name, states in (("match", matches), ("health", [step.health for step in steps])):
            before = [self._states[name], *states[:-1]]
            changes = [row for row, state in enumerate(states) if state != before[row]]
            if changes:
                changed = rr.StateChange.columns(state=[states[row] for row in changes])
                self._out.send(f"/state/{name}", times[changes], changed)
            self._states[name] = states[-1]


def config_table(config: Mapping[str, Any]) -> str:
    """Lay a nested configuration out as a Markdown table."""

    def rows(values: Mapping[str, Any], prefix: str) -> Iterator[str]:
        for key, value in values.items():
            if isinstance(value, Mapping):
                yield from rows(value, f"{prefix}{key}.")
            else:
                yield f"| `{prefix}{key}` | {value} |"

    return "\n".join(["| key | value |", "|---|---|", *rows(config, "")])


def summary_text(result: RunResult) -> str:
    """Say a run's figures in Markdown."""
    n_closures = sum(edge.kind == "closure" for edge in result.edges)
    lines = [
        f"# {result.method}{'' if result.is_complete else ' (interrupted)'}",
        "| | |",
        "|---|---|",
        f"| scans | {len(result.stamps)} ({result.n_skipped} skipped) |",
        f"| graph | {len(result.nodes)} nodes, {n_closures} loop closures |",
        f"| failed matches | {result.n_failed_matches} |",
    ]
    for stage, took in result.stage_ms.items():
        if np.isfinite(took).any():
            lines.append(f"| {stage} | {np.nanmedian(took):.3f} ms in the median |")
    for state in get_args(Health):
        n_scans = int(np.count_nonzero(result.health == state))
        if n_scans and state != "healthy":
            lines.append(f"| {state} | {n_scans} scans |")
    if result.verdict:
        lines += ["", "## Verdict", *(f"- {finding.severity}: {finding.text}" for finding in result.verdict)]
    return "\n".join(lines)
