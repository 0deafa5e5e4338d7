"""The table at the end of `run`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from slammot_graph.cli.console import N_REASONS, odometry_rows, source_rows

if TYPE_CHECKING:
    from slammot_graph.core.results import RunResult
    from slammot_graph.logs import LaserLog
    from slammot_graph.run import Run

NIS_HINT = (
    "about 3 is right; less: the odometry is better than its settings say, more: worse;"
    " `slammot-graph calibrate` estimates them"
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """What a run left behind."""

    result: "RunResult"
    run: "Run"
    log: "LaserLog"
    output: Path
    was_interrupted: bool
    failure: Exception | None
    """What ended the run, or went wrong at its end."""


def run_table(outcome: Outcome) -> Table:
    """What a run found, as a table for the console."""
    import numpy as np

    from slammot_graph.evaluation import path_length
    from slammot_graph.logs import source_of
    from slammot_graph.run_folder.directory import RUN_FILES

    result, log = outcome.result, outcome.log
    table = Table(title=f"{result.method} on {log.path.name}", show_header=False)
    step_ms = result.stage_ms.get("step", np.zeros(0))
    reasons = "; ".join(f"{scan.place}: {scan.reason}" for scan in log.skipped[:N_REASONS])
    for name, text in source_rows(source_of(log)).items():
        table.add_row(name, text)
    table.add_row("scans", f"{len(result.stamps)}{_share_of_log(outcome)}")
    table.add_row("skipped", f"{result.n_skipped}" + (f" ({reasons})" if reasons else ""))
    table.add_row("duration", f"{np.ptp(result.stamps):.1f} s")
    table.add_row("path length", f"{path_length(result.T_map_base):.1f} m")
    table.add_row("failed matches", str(result.n_failed_matches))
    table.add_row("tracks", str(len(np.unique(result.tracks[:, 1]))))
    table.add_row("nodes", str(len(result.nodes)))
    table.add_row("loop closures", str(sum(edge.kind == "closure" for edge in result.edges)))
    if np.isfinite(result.nis).any():
        table.add_row("mean NIS", f"{np.nanmean(result.nis):.2f} ({NIS_HINT})")
    if step_ms.size:
        median, p95 = np.percentile(step_ms, [50, 95])
        table.add_row("ms per scan", f"{median:.2f} median, {p95:.2f} p95")
    for name, text in odometry_rows(result.odometry).items():
        table.add_row(name, text)
    table.add_row("health", _health_cell(result))
    if result.verdict:
        table.add_row("verdict", "\n".join(f"{f.severity}: {f.text}" for f in result.verdict))
    names = [name for name in RUN_FILES if (outcome.output / name).exists()]
    table.add_row("files", f"{outcome.output}\n{', '.join(names)}")
    return table


def _health_cell(result: "RunResult") -> str:
    """Count the scans of each state."""
    import numpy as np

    states, counts = np.unique(result.health, return_counts=True)
    shown = sorted(zip(counts.tolist(), states.tolist(), strict=True), reverse=True)
    return ", ".join(f"{state} {count}" for count, state in shown) or "-"


def _share_of_log(outcome: Outcome) -> str:
    """Say so where not the whole log was run."""
    result, max_scans, n_scans = outcome.result, outcome.run.max_scans, outcome.log.n_scans
    if not outcome.run.is_complete:
        return " (not the whole log)"
    if max_scans is not None and n_scans is not None and len(result.stamps) + result.n_skipped < n_scans:
        return f" (the first {max_scans} scans of {n_scans})"
    return ""
