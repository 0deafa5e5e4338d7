"""Markdown tables with what made them, and the statistics in their cells."""

import importlib.metadata
import math
import platform
from collections.abc import Sequence
from pathlib import Path

from experiments.common import Options, say
from slammot_graph import __version__
from slammot_graph.evaluation import bootstrap_median, holm, p_text, paired_p
from slammot_graph.evaluation import median_text as median_interval
from slammot_graph.study.code_version import version_of
from slammot_graph.study.report import Table
from slammot_graph.study.results import machine, revision

__all__ = [
    "Table",
    "bootstrap_median",
    "holm",
    "median_interval",
    "number",
    "p_text",
    "paired_p",
    "provenance",
    "write_tables",
]

PACKAGES = ("numpy", "numba", "scipy", "gtsam", "kiss-icp", "evo")


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
        f"- Machine: {machine()}, {options.jobs} process(es)",
        f"- Versions: Python {platform.python_version()}, {versions}",
        f"- Revision: {revision()}",
        f"- Code: {version_of(f'experiments.{name}:experiment')} of version {__version__}",
        *(["- **Quick mode: these figures say nothing.**"] if options.quick else []),
    ]


def number(value: float, n_decimals: int = 3) -> str:
    """A number as text, "-" for NaN."""
    return "-" if math.isnan(value) else f"{value:.{n_decimals}f}"
