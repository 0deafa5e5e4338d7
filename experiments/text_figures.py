"""Do the figures in README and docs stand in the tables that they name? ``python -m experiments.text_figures`` tells.

A section of the text (from a bold heading on) names its experiments as ``experiments.NAME``; each figure in the
Markdown tables of the section must be there, as a rounding, in one of the tables of these, in a row with the same
label where there is one.
"""

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from experiments.common import ROOT

TEXTS = ("README.md", "docs/results.md")
_NUMBER = re.compile(r"(?<![\w.])-?\d*\.\d+(?:e[-+]?\d+)?")
_LABELS = {"wheels": ("odometry", "wheels"), "Intel": ("intel",), "ACES": ("aces",), "FR079": ("fr079",)}
"""Words of the texts, and those of the tables for them."""


@dataclass(frozen=True, kw_only=True)
class Stranger:
    """A figure that no table has.

    Attributes
    ----------
    text : str
        The file.
    line : int
    figure : str
    tables : tuple of str
        Where it was looked for; empty where the section names no experiment with a committed table.
    """

    text: str
    line: int
    figure: str
    tables: tuple[str, ...]

    def __str__(self) -> str:
        where = ", ".join(self.tables) or "no committed table"
        return f"{self.text}:{self.line}: {self.figure} is not in {where}"


def strangers(text: Path, tables: Path) -> list[Stranger]:
    """Figures of a text's tables that stand in none of the tables which their section names."""
    found = []
    for lines, names in _sections(text.read_text(encoding="utf-8").splitlines()):
        known = [name for name in names if (tables / f"{name}.md").is_file()]
        parts = [part for name in known for part in _parts(tables / f"{name}.md")]
        for number, line in lines:
            if not names or not line.startswith("|"):
                continue
            label = _label(line)
            rows = [row for part in parts for row in _with_label(part, label)]
            figures = {figure for row in rows for figure in _NUMBER.findall(row)}
            found += [
                Stranger(text=text.name, line=number, figure=figure, tables=tuple(known))
                for figure in _NUMBER.findall(line)
                if not any(is_rounding(figure, other) for other in figures)
            ]
    return found


def is_rounding(figure: str, of: str) -> bool:
    """Whether a figure is another one, rounded to the decimals that it shows."""
    n_decimals = len(figure.partition("e")[0].partition(".")[2])
    if "e" in figure or "e" in of:
        return f"{float(of):.{n_decimals}e}" == f"{float(figure):.{n_decimals}e}"
    half = 0.5000001 * 10.0**-n_decimals
    return abs(float(of) - float(figure)) <= half and len(of.partition(".")[2]) >= n_decimals - 1


def _sections(lines: list[str]) -> Iterator[tuple[list[tuple[int, str]], list[str]]]:
    """Numbered lines from one bold heading to the next, and the experiments that they name."""
    starts = [k for k, line in enumerate(lines) if line.startswith("**") or line.startswith("#")]
    for start, end in zip(starts, [*starts[1:], len(lines)], strict=True):
        part = "\n".join(lines[start:end])
        names = re.findall(r"experiments[./](?:tables/)?([a-z_]+)", part)
        names += re.findall(r"`(paper_[a-z_]+)`", part)
        yield [(k + 1, lines[k]) for k in range(start, end)], sorted(set(names))


def _parts(table: Path) -> list[list[str]]:
    """Rows with figures of each table in a file."""
    parts: list[list[str]] = [[]]
    for line in table.read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            parts.append([])
        elif line.startswith("|") and _NUMBER.search(line):
            parts[-1].append(line)
    return parts


def _with_label(rows: list[str], label: tuple[str, ...]) -> list[str]:
    """Rows of a table that have the label; all where none has it."""
    return [row for row in rows if any(word in row for word in label)] or rows


def _label(line: str) -> tuple[str, ...]:
    first = line.strip("| ").split("|")[0].strip()
    for word, others in _LABELS.items():
        if first.startswith(word):
            return tuple(f"| {other} |" for other in others)
    method = re.match(r"`([\w-]+)`", first)
    return (f"| {method[1]} |",) if method else ()


def main() -> int:
    """Print the figures that no table has; the exit code is 1 if there are any."""
    found = [one for name in TEXTS for one in strangers(ROOT / name, ROOT / "experiments" / "tables")]
    for one in found:
        print(one)
    print(f"{len(found)} figures are in no table that their section names")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
