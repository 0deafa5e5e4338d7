"""The command that says what is wrong with a log: `check`."""

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.table import Table

from slammot_graph.cli.console import (
    EXIT_FOUND,
    EXIT_OK,
    N_REASONS,
    odometry_rows,
    progress,
    source_rows,
    stdout,
    warn,
)
from slammot_graph.cli.reading import DEFAULT_READING, Reading
from slammot_graph.core.strict_json import strict_json

if TYPE_CHECKING:
    from slammot_graph.core.scan import LaserModel
    from slammot_graph.diagnosis import CheckReport
    from slammot_graph.logs import LaserLog


def check_command(
    log: Annotated[Path, tyro.conf.arg(metavar="LOG")],
    /,
    *,
    max_range: Annotated[float, tyro.conf.arg(metavar="M")] = math.inf,
    reading: Reading = DEFAULT_READING,
    as_json: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> int:
    """Say in seconds what is wrong with a log, with the likely cause and the remedy; writes nothing.

    All scans are read and inspected; the first ones are matched, as many as fit into a few seconds. Exit code 1 if
    there is an error, with which a run is of no use; warnings leave it at 0.

    Parameters
    ----------
    log
        As for `slammot-graph run`.
    max_range
        Leave aside what is farther [m].
    reading
        What of the log is read, and how.
    as_json
        Print JSON in place of the table.
    """
    from slammot_graph.diagnosis import check_log

    opened = reading.open(log)
    with progress(f"check of {log.name}", opened.n_scans, "scans", passed_over=opened.skipped) as show:
        report = check_log(opened, max_range_m=None if math.isinf(max_range) else max_range, show=show)
    if as_json:
        stdout().print(json.dumps(strict_json(_plain(report)), indent=2, ensure_ascii=False), soft_wrap=True)
    else:
        warn(opened, report.log.warnings)
        stdout().print(_table(opened, report))
    has_error = any(finding.severity == "error" for finding in report.verdict)
    return EXIT_FOUND if has_error else EXIT_OK


def _table(log: "LaserLog", report: "CheckReport") -> Table:
    scans, raw, laser = report.scans, report.raw_odometry, report.scans.laser
    table = Table(title=f"check of {log.path.name}", show_header=False)
    for name, text in source_rows(report.log.source).items():
        table.add_row(name, text)
    reasons = "; ".join(f"{scan.place}: {scan.reason}" for scan in log.skipped[:N_REASONS])
    table.add_row("scans", f"{scans.n_scans} usable, the first {report.n_matched_scans} of them matched")
    table.add_row("skipped", f"{report.n_skipped}" + (f" ({reasons})" if reasons else ""))
    if laser is not None:
        table.add_row("duration", f"{scans.duration_s:.1f} s, {_known(scans.rate_hz, 'scans a second', 2)}")
        table.add_row("beams", _beams(laser, scans.n_lasers))
        table.add_row("ranges", _ranges(report))
    if raw.n_with_odometry:
        share = (
            "" if raw.n_with_odometry == raw.n_scans else f", in {raw.n_with_odometry} of {raw.n_scans} scans"
        )
        told = f"{raw.distance_m:.1f} m, {math.degrees(raw.turn_rad):.0f} degrees turned in all{share}"
        table.add_row("raw odometry", told)
    for name, text in odometry_rows(report.odometry).items():
        table.add_row(name, text)
    health = sorted(((n, state) for state, n in report.health.items()), reverse=True)
    table.add_row("health", ", ".join(f"{state} {n}" for n, state in health) or "-")
    verdict = "\n".join(f"{finding.severity}: {finding.text}" for finding in report.verdict)
    table.add_row("verdict", verdict or "nothing wrong was found")
    return table


def _beams(laser: "LaserModel", n_lasers: int) -> str:
    view = math.degrees(laser.field_of_view_rad)
    step = math.degrees(abs(laser.angle_increment))
    changes = "" if n_lasers == 1 else f"; the geometry changes {n_lasers - 1} times"
    return f"{laser.n_beams} over {view:.4g} degrees, {step:.3g} degrees apart{changes}"


def _ranges(report: "CheckReport") -> str:
    import numpy as np

    scans = report.scans
    assert scans.laser is not None
    medians, nearest = (column[np.isfinite(column)] for column in (scans.median_range_m, scans.nearest_m))
    median = _known(float(np.median(medians)) if len(medians) else math.nan, "m", 2)
    least = _known(float(nearest.min()) if len(nearest) else math.nan, "m", 2)
    empty = 100.0 * float(np.mean(scans.no_return_share))
    limits = f"limits {scans.laser.range_min:g} to {scans.laser.range_max:g} m"
    return f"median {median}, nearest {least}, {empty:.0f}% of the beams without a return; {limits}"


def _known(value: float, unit: str, n_decimals: int) -> str:
    return f"{value:.{n_decimals}f} {unit}" if math.isfinite(value) else "-"


def _plain(report: "CheckReport") -> dict[str, Any]:
    """Give the report as plain values."""
    import numpy as np

    scans, raw, laser = report.scans, report.raw_odometry, report.scans.laser
    medians = scans.median_range_m
    medians = medians[np.isfinite(medians)]
    return {
        "log": report.log.path,
        "source": dict(report.log.source),
        "warnings": report.log.warnings,
        "n_scans": scans.n_scans,
        "n_matched_scans": report.n_matched_scans,
        "n_skipped": report.n_skipped,
        "duration_s": scans.duration_s,
        "rate_hz": scans.rate_hz,
        "laser": None if laser is None else asdict(laser),
        "field_of_view_rad": scans.field_of_view_rad,
        "median_range_m": float(np.median(medians)) if len(medians) else math.nan,
        "no_return_share": float(np.mean(scans.no_return_share)) if scans.n_scans else math.nan,
        "raw_odometry": {
            "n_scans": raw.n_with_odometry,
            "distance_m": raw.distance_m,
            "turn_rad": raw.turn_rad,
        },
        "odometry": asdict(report.odometry),
        "health": report.health,
        "verdict": [{**asdict(finding), "text": finding.text} for finding in report.verdict],
    }
