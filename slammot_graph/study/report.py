"""Tables of a study's results: medians with intervals, and tests of the methods against the reference."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from slammot_graph.evaluation import holm, median_text, p_text, paired_p
from slammot_graph.study.results import Results

HEADINGS = {
    "ate_m": ("ATE [m]", 4),
    "ate_deg": ("heading error [deg]", 3),
    "rpe_m": ("RPE over 1 m [m]", 4),
    "rpe_deg": ("RPE over 1 m [deg]", 3),
    "relations_m": ("relations [m]", 4),
    "relations_std_m": ("their std [m]", 4),
    "relations_deg": ("relations [deg]", 3),
    "iou": ("point IoU", 3),
    "precision": ("precision", 3),
    "recall": ("recall", 3),
    "static_kept": ("static points kept", 4),
    "ghosts_per_m2": ("ghost cells/m^2", 3),
    "lost_per_m2": ("lost wall cells/m^2", 3),
    "mota": ("MOTA", 3),
    "idf1": ("IDF1", 3),
    "hota": ("HOTA", 3),
    "track_m": ("tracks' position [m]", 3),
    "n_scans": ("scans", 0),
    "n_closures": ("closures", 0),
    "n_failed_matches": ("failed matches", 0),
}
"""Heading with unit, and decimals."""
MORE_IS_BETTER = ("iou", "precision", "recall", "static_kept", "mota", "idf1", "hota")
_TEX = {"&": r"\&", "%": r"\%", "_": r"\_", "#": r"\#", "$": r"\$", "^": r"\^{}", "~": r"\~{}"}


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of texts.

    Attributes
    ----------
    heading : str
    columns : sequence of str
    rows : sequence of sequences of str
    """

    heading: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]

    def markdown(self) -> str:
        """The table as Markdown, the first column to the left, the others to the right."""
        rule = [":--", *["--:"] * (len(self.columns) - 1)]
        lines = [self.columns, rule, *self.rows]
        return f"## {self.heading}\n\n" + "\n".join("| " + " | ".join(line) + " |" for line in lines)

    def latex(self) -> str:
        """The table as LaTeX (booktabs)."""
        rows = [" & ".join(map(_tex, line)) + r" \\" for line in self.rows]
        return "\n".join(
            [
                r"\begin{table}",
                rf"\caption{{{_tex(self.heading)}}}",
                rf"\begin{{tabular}}{{l{'r' * (len(self.columns) - 1)}}}",
                r"\toprule",
                " & ".join(map(_tex, self.columns)) + r" \\",
                r"\midrule",
                *rows,
                r"\bottomrule",
                r"\end{tabular}",
                r"\end{table}",
            ]
        )


def tables(results: Results) -> list[Table]:
    """A table for each world: a row for each method and override, a column for each measure.

    The last column tests the first measure against the reference, seed by seed: Wilcoxon's signed-rank test, two
    sides, Holm's correction over the rows of the table. An override is tested against its own method without it.
    """
    measures = shown_measures(results)
    worlds = list(dict.fromkeys(row["world"] for row in results.rows))
    return [_table(results, world, measures) for world in worlds]


def shown_measures(results: Results) -> list[str]:
    """Columns of the report: those that were asked for, else all that are known of."""
    asked = [name for name in results.origin.get("measures", ()) if name in results.measures]
    return asked or [name for name in results.measures if name in HEADINGS] or results.measures


def values_of(results: Results, world: str, method: str, override: str, measure: str) -> dict[Any, float]:
    """A measure by seed; NaN where it is not known."""
    return {
        row["seed"]: math.nan if row[measure] is None else row[measure]
        for row in results.rows
        if (row["world"], row["method"], row["override"]) == (world, method, override)
    }


def origin_lines(results: Results) -> list[str]:
    """Command, revision and versions, as lines."""
    origin = results.origin
    versions = ", ".join(f"{name} {version}" for name, version in origin.get("versions", {}).items())
    lines = [
        f"Command: `{origin.get('command', 'unknown')}`",
        f"Revision: {origin.get('revision', 'unknown')}, version {origin.get('version', 'unknown')}, code"
        f" {origin.get('code', 'unknown')}",
        f"Versions: {versions}",
        f"Machine: {origin.get('machine', 'unknown')}",
    ]
    n_rows, n_finished = origin.get("n_rows"), origin.get("n_finished")
    if n_rows != n_finished:
        lines.append(
            f"**{n_finished} of {n_rows} cells are finished, {origin.get('n_failed', 0)} failed (failed.csv)**"
        )
    if origin.get("quick"):
        lines.append("**Quick: few seeds, whose figures say little**")
    return lines


def markdown(results: Results, made: Sequence[Table]) -> str:
    """All tables as one Markdown page."""
    head = [f"# {results.origin.get('title') or 'Study'}", "", NOTE, ""]
    head += [f"- {line}" for line in origin_lines(results)]
    return "\n".join(head) + "\n\n" + "\n\n".join(table.markdown() for table in made) + "\n"


def latex(results: Results, made: Sequence[Table]) -> str:
    """All tables as LaTeX, to be included."""
    head = [f"% {line}" for line in origin_lines(results)]
    return "\n".join([*head, *(table.latex() for table in made)]) + "\n"


NOTE = (
    "Median over the seeds [95% bootstrap interval]. p: paired Wilcoxon signed-rank test of the first measure"
    " against the reference, two-sided, with Holm's correction over the rows of a table; an"
    " override is tested against its own method."
)


def _table(results: Results, world: str, measures: list[str]) -> Table:
    of_world = [row for row in results.rows if row["world"] == world]
    variants = list(dict.fromkeys((row["method"], row["override"]) for row in of_world))
    reference = results.origin.get("reference") or variants[0][0]
    seeds = {row["seed"] for row in of_world}
    p_values, better = {}, {}
    for method, override in variants:
        against = (method, "") if override else (reference, "")
        if (method, override) == against or against not in variants:
            continue
        own = values_of(results, world, method, override, measures[0])
        theirs = values_of(results, world, *against, measures[0])
        shared = [seed for seed in own if seed in theirs]
        pairs = [own[seed] for seed in shared], [theirs[seed] for seed in shared]
        name = f"{method} {override}"
        p_values[name] = paired_p(*pairs)
        sign = -1.0 if measures[0] in MORE_IS_BETTER else 1.0
        better[name] = f"{sum(sign * (a - b) < 0.0 for a, b in zip(*pairs, strict=True))} of {len(shared)}"
    p_values = holm(p_values)
    rows = []
    for method, override in variants:
        name = f"{method} {override}"
        verdict = ""
        if name in p_values:
            verdict = f"{p_text(p_values[name])} (better in {better[name]})"
        cells = [
            _figure(list(values_of(results, world, method, override, measure).values()), measure)
            for measure in measures
        ]
        rows.append([f"{method}, {override}" if override else method, *cells, verdict])
    drawn = len(seeds - {None})
    heading = f"{world}: {drawn} seeds" if drawn else world
    return Table(
        heading=heading,
        columns=[
            "method",
            *(HEADINGS.get(name, (name, 3))[0] for name in measures),
            f"against {reference}, p",
        ],
        rows=rows,
    )


def _figure(values: list[float], measure: str) -> str:
    n_decimals = HEADINGS.get(measure, ("", 3))[1]
    if len(values) == 1:
        return "-" if math.isnan(values[0]) else f"{values[0]:.{n_decimals}f}"
    return median_text(values, n_decimals)


def _tex(text: str) -> str:
    return "".join(_TEX.get(letter, letter) for letter in text)
