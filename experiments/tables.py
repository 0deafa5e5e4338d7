"""Markdown tables with what made them, and the statistics in their cells."""

import importlib.metadata
import math
import os
import platform
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import stats

from experiments.common import ROOT, Options, say

N_BOOTSTRAP = 2000
PACKAGES = ("numpy", "numba", "scipy", "gtsam", "kiss-icp", "evo")


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table with a heading of its own; rows are texts."""

    heading: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]

    def markdown(self) -> str:
        """The table as Markdown, the first column to the left, the others to the right."""
        rule = [":--", *["--:"] * (len(self.columns) - 1)]
        lines = [self.columns, rule, *self.rows]
        return f"## {self.heading}\n\n" + "\n".join("| " + " | ".join(line) + " |" for line in lines)


def write_tables(
    name: str, title: str, notes: Sequence[str], tables: Sequence[Table], options: Options
) -> Path:
    """Write ``tables/<name>.md``: title, notes, where it comes from, tables."""
    head = [f"# {title}", "", *notes, "", *provenance(name, options), ""]
    path = options.folder("tables") / f"{name}.md"
    text = "\n".join(head) + "\n" + "\n\n".join(table.markdown() for table in tables) + "\n"
    path.write_text(text, encoding="utf-8")
    say(f"{name}: {path}")
    return path


def provenance(name: str, options: Options) -> list[str]:
    """Command, machine, versions and revision, as Markdown lines without a date."""
    words = ["python", "-m", f"experiments.{name}"]
    words += ["--quick"] if options.quick else []
    words += ["--seeds", str(options.seeds)] if options.seeds else []
    words += [*options.more_words, "--jobs", str(options.jobs)]
    versions = ", ".join(f"{package} {importlib.metadata.version(package)}" for package in PACKAGES)
    return [
        f"- Command: `{' '.join(words)}`",
        f"- Machine: {_cpu_model()}, {os.cpu_count()} cores, {options.jobs} process(es)",
        f"- Versions: Python {platform.python_version()}, {versions}",
        f"- Revision: {_revision()}",
        *(["- **Quick mode: these figures say nothing.**"] if options.quick else []),
    ]


def median_interval(values: Sequence[float], n_decimals: int = 3) -> str:
    """Median with its 95% bootstrap interval (percentile, seeded); NaN values are left out."""
    median, low, high = bootstrap_median(values)
    if math.isnan(median):
        return "-"
    return f"{median:.{n_decimals}f} [{low:.{n_decimals}f}, {high:.{n_decimals}f}]"


def bootstrap_median(values: Sequence[float]) -> tuple[float, float, float]:
    """Median and the bounds of its 95% interval; NaN over nothing."""
    kept = np.array([value for value in values if not math.isnan(value)])
    if kept.size == 0:
        return math.nan, math.nan, math.nan
    draws = np.random.default_rng(0).integers(kept.size, size=(N_BOOTSTRAP, kept.size))
    low, high = np.percentile(np.median(kept[draws], axis=1), [2.5, 97.5])
    return float(np.median(kept)), float(low), float(high)


def paired_p(a: Sequence[float], b: Sequence[float]) -> float:
    """Two-sided paired Wilcoxon signed-rank test; NaN under two pairs, 1 if no pair differs."""
    pairs = [(x, y) for x, y in zip(a, b, strict=True) if not (math.isnan(x) or math.isnan(y))]
    difference = np.array([x - y for x, y in pairs])
    if len(difference) < 2:
        return math.nan
    if not difference.any():
        return 1.0
    return float(stats.wilcoxon(difference).pvalue)


def holm(p_values: Mapping[str, float]) -> dict[str, float]:
    """Holm's correction of the p-values of one family; NaN stays and is not counted."""
    ordered = sorted((p, key) for key, p in p_values.items() if not math.isnan(p))
    corrected = dict(p_values)
    running = 0.0
    for k, (p, key) in enumerate(ordered):
        running = max(running, min(1.0, (len(ordered) - k) * p))
        corrected[key] = running
    return corrected


def p_text(p: float) -> str:
    """A p-value as text."""
    if math.isnan(p):
        return "-"
    return f"{p:.1e}" if p < 0.001 else f"{p:.3f}"


def number(value: float, n_decimals: int = 3) -> str:
    """A number as text, "-" for NaN."""
    return "-" if math.isnan(value) else f"{value:.{n_decimals}f}"


def _cpu_model() -> str:
    path = Path("/proc/cpuinfo")
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown CPU"


def _revision() -> str:
    def git(*words: str) -> str:
        done = subprocess.run(
            ["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=False, timeout=20
        )
        return done.stdout.strip()

    try:
        changed = git("status", "--porcelain", "--", "slammot_graph")
        return (git("rev-parse", "--short", "HEAD") or "unknown") + (
            " with local changes in slammot_graph" if changed else ""
        )
    except (OSError, subprocess.TimeoutExpired):
        return "unknown"
