"""The report of a study on disk: tables, figures, and one HTML page that needs nothing but itself."""

import base64
import html
import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from slammot_graph.evaluation import bootstrap_median
from slammot_graph.study.report import (
    HEADINGS,
    NOTE,
    Table,
    latex,
    markdown,
    origin_lines,
    shown_measures,
    tables,
    values_of,
)
from slammot_graph.study.results import Results, read_results, replaced

MOST_FIGURES = 4
"""So many measures are drawn; all are in the tables."""
_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2em auto; max-width: 1200px; padding: 0 1em; color: #222 }
table { border-collapse: collapse; margin: 1em 0; font-variant-numeric: tabular-nums; font-size: 13px }
th, td { padding: .3em .8em; border-bottom: 1px solid #ddd; text-align: right; white-space: nowrap }
th:first-child, td:first-child { text-align: left } thead th { border-bottom: 2px solid #444 }
.wide { overflow-x: auto } img { max-width: 100% } figcaption, .origin { color: #666; font-size: 13px }
code { background: #f3f3f3; padding: .1em .3em }
"""


def write_report(folder: Path) -> Path:
    """Write ``report/tables.md``, ``tables.tex``, ``figures/*.png`` and ``index.html`` from a study's results.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        The folder holds no results, or cannot be written.
    """
    results = read_results(folder)
    made = tables(results)
    report = folder / "report"
    figures = report / "figures"
    figures.mkdir(parents=True, exist_ok=True)
    drawn = [_drawn(results, measure, figures) for measure in shown_measures(results)[:MOST_FIGURES]]
    pictures = sorted(folder.glob("pictures/*.png"))
    for path, text in (
        (report / "tables.md", markdown(results, made)),
        (report / "tables.tex", latex(results, made)),
        (report / "index.html", page(results, made, [*pictures, *drawn])),
    ):
        with replaced(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return report / "index.html"


def page(results: Results, made: Sequence[Table], pictures: Sequence[Path]) -> str:
    """The HTML page, its figures within it."""
    title = html.escape(str(results.origin.get("title") or "Study"))
    command = html.escape(str(results.origin.get("command", "unknown")))
    revision = html.escape(str(results.origin.get("revision", "unknown")))
    origin = "".join(f"<li>{_marked(line)}</li>" for line in origin_lines(results))
    figures = "".join(
        f'<figure><img src="data:image/png;base64,{base64.b64encode(path.read_bytes()).decode()}"'
        f' alt="{html.escape(_caption(path))}"><figcaption>{html.escape(_caption(path))}. <code>{command}</code>,'
        f" revision {revision}</figcaption></figure>"
        for path in pictures
    )
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f'<style>{_STYLE}</style></head><body><h1>{title}</h1><ul class="origin">{origin}</ul>'
        f"<p>{html.escape(NOTE)}</p>{''.join(map(_html_table, made))}{figures}</body></html>\n"
    )


def _caption(path: Path) -> str:
    name = path.stem
    return HEADINGS[name][0] + ", median and 95% interval" if name in HEADINGS else name.replace("_", " ")


def _marked(line: str) -> str:
    """A line of Markdown with code and bold as HTML."""
    import re

    text = html.escape(line)
    text = re.sub(r"`([^`]+)`", r"<code>\1</code>", text)
    return re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", text)


def _html_table(table: Table) -> str:
    def row(cells: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    body = "".join(row(line, "td") for line in table.rows)
    return (
        f'<h2>{html.escape(table.heading)}</h2><div class="wide"><table><thead>{row(table.columns, "th")}</thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _drawn(results: Results, measure: str, folder: Path) -> Path:
    """Medians with their intervals: a panel for each world, a line for each method and override."""
    from matplotlib.figure import Figure

    worlds = list(dict.fromkeys(row["world"] for row in results.rows))
    variants = list(dict.fromkeys((row["method"], row["override"]) for row in results.rows))
    n_columns = min(len(worlds), 4)
    n_rows = -(-len(worlds) // n_columns)
    figure = Figure(
        figsize=(3.2 * n_columns + 1.5, (0.28 * len(variants) + 1.0) * n_rows), layout="constrained"
    )
    axes = figure.subplots(n_rows, n_columns, squeeze=False, sharey=True)
    names = [f"{method}, {override}" if override else method for method, override in variants]
    for panel, world in zip(axes.flat, worlds, strict=False):
        _draw_panel(panel, results, world, variants, measure)
        panel.set_title(world, fontsize=9)
        panel.set_yticks(range(len(names)), names, fontsize=8)
        panel.tick_params(axis="x", labelsize=8)
        panel.grid(axis="x", alpha=0.3)
    for panel in axes.flat[len(worlds) :]:
        panel.set_visible(False)
    axes.flat[0].invert_yaxis()
    heading = HEADINGS.get(measure, (measure, 3))[0]
    origin = f"{results.origin.get('command', '')}, revision {results.origin.get('revision', '')}"
    made_by = textwrap.fill(origin, int(16 * figure.get_size_inches()[0])).replace("$", r"\$")
    figure.supxlabel(f"{heading}\n{made_by}", fontsize=7)
    path = folder / f"{measure}.png"
    with replaced(path) as temporary:
        figure.savefig(temporary, dpi=130, format="png")
    return path


def _draw_panel(
    panel: Any, results: Results, world: str, variants: Sequence[tuple[str, str]], measure: str
) -> None:
    for k, (method, override) in enumerate(variants):
        median, low, high = bootstrap_median(
            list(values_of(results, world, method, override, measure).values())
        )
        if not math.isnan(median):
            panel.plot([low, high], [k, k], color="tab:blue", linewidth=2.5, alpha=0.5)
            panel.plot([median], [k], "o", color="tab:blue", markersize=4)
    low, high = panel.get_xlim()
    if low > 0.0 and high / low > 30.0 and measure.endswith("_m"):
        panel.set_xscale("log")
