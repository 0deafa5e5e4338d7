"""``summary.json``: method, configuration, versions and figures of a run."""

import json
import platform
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from importlib import metadata
from pathlib import Path
from typing import Any, get_args

import numpy as np

from slammot_graph.core.errors import InputError
from slammot_graph.core.files import MOST_SETTINGS_BYTES, check_regular
from slammot_graph.core.results import Health, RunResult
from slammot_graph.core.strict_json import strict_json
from slammot_graph.core.types import FloatArray
from slammot_graph.evaluation import path_length, run_consistency
from slammot_graph.run_folder.atomic import write_text

MAX_EVENTS = 200
"""So many events are named in ``summary.json``; the rest is counted."""
MAX_INTERVALS = 200
"""So many intervals of scans that are not healthy are named; the rest is in the counts."""
PACKAGES = (
    "gtsam",
    "numpy",
    "scipy",
    "numba",
    "kiss-icp",
    "rerun-sdk",
    "rosbags",
    "matplotlib",
)


def summarize_run(result: RunResult) -> dict[str, Any]:
    """Make the summary of a run; paths, arrays and numbers that are not finite become JSON by `write_summary`."""
    step_ms = result.stage_ms.get("step", np.zeros(0))
    n_valid = int(np.count_nonzero(result.is_valid))
    n_moving = int(np.count_nonzero(result.is_moving & result.is_valid))
    log = result.log
    return {
        "method": result.method,
        "log": None if log.path is None else log.path.absolute(),
        "source": log.source,
        "warnings": log.warnings,
        "config": result.config,
        "versions": _versions(),
        "is_complete": result.is_complete,
        "failures": result.failures,
        "n_scans": len(result.stamps),
        "n_scans_of_log": log.n_scans,
        "n_skipped": result.n_skipped,
        "n_failed_matches": result.n_failed_matches,
        "n_nodes": len(result.nodes),
        "n_loop_closures": sum(edge.kind == "closure" for edge in result.edges),
        "path_length_m": path_length(result.T_map_base),
        "duration_s": float(np.ptp(result.stamps)) if len(result.stamps) else 0.0,
        "n_tracks": len(np.unique(result.tracks[:, 1])),
        "moving_share": n_moving / n_valid if n_valid else None,
        "nis": _figures(result.nis, with_mean=True),
        "consistency": asdict(run_consistency(result)),
        "stages_ms": {stage: _figures(took) for stage, took in result.stage_ms.items()},
        "scans_per_s": 1e3 * len(step_ms) / float(step_ms.sum()) if step_ms.sum() > 0.0 else None,
        "peak_memory_mb": _peak_memory_mb(),
        "health": _health(result),
        "odometry": asdict(result.odometry),
        "verdict": [{**asdict(finding), "text": finding.text} for finding in result.verdict],
        "n_events": len(result.events),
        "events": [{**asdict(event), "text": event.text} for event in result.events[:MAX_EVENTS]],
    }


def write_summary(path: Path, result: RunResult) -> None:
    """Write the summary of a run.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    summary = json.dumps(strict_json(summarize_run(result)), indent=2, allow_nan=False, ensure_ascii=False)
    write_text(path, [summary])


def read_summary(path: Path) -> Mapping[str, Any]:
    """Read a summary; empty where there is no file.

    Raises
    ------
    InputError
        The file is not a JSON object.
    """
    if not path.exists():
        return {}
    check_regular(path, MOST_SETTINGS_BYTES)
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        summary = None
    if not isinstance(summary, dict):
        raise InputError(f"{path}: not the JSON of a run's summary; remove it or run again")
    return summary


def _figures(values: FloatArray, *, with_mean: bool = False) -> dict[str, float | None]:
    """Median and 95th percentile, over what is finite; None over nothing."""
    known = values[np.isfinite(values)]
    if not len(known):
        return dict.fromkeys(("median", "mean", "p95") if with_mean else ("median", "p95"))
    median, p95 = np.percentile(known, [50, 95]).tolist()
    return {"median": median, **({"mean": float(known.mean())} if with_mean else {}), "p95": p95}


def _health(result: RunResult) -> dict[str, Any]:
    """Count the scans of each state, and name the intervals of scans that are not healthy: first and last index."""
    health = result.health
    starts = np.flatnonzero(np.append(True, health[1:] != health[:-1])) if len(health) else np.empty(0, int)
    ends = np.append(starts[1:], len(health)) - 1
    intervals = [
        {"state": str(health[first]), "first": int(first), "last": int(last)}
        for first, last in zip(starts, ends, strict=True)
        if health[first] != "healthy"
    ]
    return {
        "counts": {state: int(np.count_nonzero(health == state)) for state in get_args(Health)},
        "n_intervals": len(intervals),
        "intervals": intervals[:MAX_INTERVALS],
    }


def _versions() -> dict[str, str]:
    from slammot_graph import __version__

    versions = {"python": platform.python_version(), "slammot-graph": __version__}
    for package in PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            versions[package] = metadata.version(package)
    return versions


def _peak_memory_mb() -> float | None:
    """Peak resident memory of this process [MB of 2^20 bytes], None where the system does not report it."""
    with suppress(OSError, ValueError):
        # not getrusage: its peak survives exec, and is then that of the program that started this one
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024.0
    try:
        import resource
    except ImportError:
        return None
    unit = 2**20 if platform.system() == "Darwin" else 2**10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit
