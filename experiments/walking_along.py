"""People who walk with the robot until they take a third or half of its beams, in recorded logs."""

import sys
from collections.abc import Sequence

import numpy as np

from experiments import measures, recorded
from experiments.common import Options, Scores, main, run_cells
from experiments.tables import Table, holm, median_interval, number, p_text, paired_p, write_tables
from slammot_graph.evaluation import evaluate_relations, relative_error

METHODS = (
    "graph",
    "graph-fixed",
    "graph-nofilter",
    "docpfo",
    "icp",
    "odometry",
    "kiss-icp",
    "kiss-icp-odometry",
)
BASELINES = ("graph-nofilter", "docpfo", "icp", "odometry", "kiss-icp", "kiss-icp-odometry")
LOGS = ("intel", "aces")
SHARES = (0.0, 0.15, 0.35, 0.51)
FULL_SEEDS, N_SCANS = 10, 1500
QUICK_SCANS = 120
LAGS_S = (5.0, 10.0)
MAX_DURATION_S = 10.0
FIGURE = "relations_m"
"""What is compared: mean translation error of the true relations whose ends lie under 10 s apart."""


def cell(log: str, reference: str, share: float, seed: int, method: str, n_scans: int) -> Scores:
    """Run one method over one log."""
    company = recorded.with_company(log, reference, share, seed, n_scans)
    result = measures.run_method(company, method)
    relations = evaluate_relations(
        result.stamps, result.T_map_base, recorded.relations_of(log), max_duration_s=MAX_DURATION_S
    )
    scores: Scores = {
        "share": _share(company.is_moving, company.ranges, company.laser.range_max),
        "n_people": company.objects.shape[1],
        "relations_m": relations.translation_m.mean,
        "relations_deg": relations.rotation_deg.mean,
        "n_relations": relations.translation_m.n,
        **measures.point_scores(result.is_moving, company, result.is_valid),
    }
    for lag in LAGS_S:
        error = relative_error(
            result.T_map_base, company.T_world_base, delta=lag, unit="s", stamps=company.stamps
        )
        scores[f"lag{lag:g}_m"] = error.translation_m.mean
    return scores


def _share(is_moving: np.ndarray, ranges: np.ndarray, range_max: float) -> float:
    return float(is_moving.sum() / (ranges < 0.97 * range_max).sum())


def key(log: str, share: float, seed: int, method: str, n_scans: int) -> str:
    """Name of a cell; without people there is one seed."""
    return f"{log} {n_scans} {share:g} {seed if share else 0} {method}"


def experiment(options: Options) -> None:
    """Let 0.25 m discs walk along, 0.8 to 2.4 m away, until they take 15, 35 and 51% of the beams."""
    seeds = options.seed_range(FULL_SEEDS, quick=1)
    logs = LOGS[:1] if options.quick else LOGS
    shares = (0.0, 0.35) if options.quick else SHARES
    n_scans = QUICK_SCANS if options.quick else N_SCANS
    cells = {}
    for log in logs:
        path = str(options.recorded(f"{log}.clf.bz2"))
        reference = recorded.make_reference(log, options, n_scans)
        for share in shares:
            for seed in seeds if share else (0,):
                for method in METHODS:
                    cells[key(log, share, seed, method, n_scans)] = {
                        "log": path,
                        "reference": reference,
                        "share": share,
                        "seed": seed,
                        "method": method,
                        "n_scans": n_scans,
                    }
    scores = run_cells("walking_along", cell, cells, options)

    def column(log: str, share: float, method: str, name: str) -> list[float]:
        return [scores[key(log, share, seed, method, n_scans)][name] for seed in seeds]

    tables = []
    for log in logs:
        for name, what in (
            (FIGURE, f"mean translation error [m] of the true relations under {MAX_DURATION_S:g} s apart"),
            ("lag5_m", "mean translation error [m] over 5 s, against the graph run on the clean log"),
            ("lag10_m", "mean translation error [m] over 10 s, against the graph run on the clean log"),
        ):
            tables.append(_errors(log, shares, name, what, column))
        tables.append(_significance(log, shares[1:], column))
        tables.append(_labels(log, shares[1:], column))
    shares_taken = {
        f"{share:.0%}": np.mean([column(log, share, "graph", "share") for log in logs]) for share in shares
    }
    notes = [
        f"The first {n_scans} scans of each log, {len(seeds)} seeds of company: median [95% bootstrap interval]."
        f" Shares of the valid beams really taken, in the order of the columns:"
        f" {', '.join(f'{share:.1%}' for share in shares_taken.values())}."
        f" True relations used: {', '.join(f'{log} {n}' for log, n in _counts(logs, column).items())}."
    ]
    write_tables("walking_along", "People who walk with the robot", notes, tables, options)


def _counts(logs: Sequence[str], column) -> dict[str, int]:  # type: ignore[no-untyped-def]
    return {log: int(column(log, 0.0, "graph", "n_relations")[0]) for log in logs}


def _errors(log: str, shares: Sequence[float], name: str, what: str, column) -> Table:  # type: ignore[no-untyped-def]
    rows = []
    for method in METHODS:
        clean = float(np.median(column(log, 0.0, method, name)))
        at_35 = float(np.median(column(log, 0.35, method, name)))
        cells = [number(clean), *(median_interval(column(log, share, method, name)) for share in shares[1:])]
        ratio = [number(at_35 / clean if clean else float("nan"), 2)] if name == FIGURE else []
        rows.append([method, *cells, *ratio])
    columns = ["method", *(f"{share:.0%}" for share in shares), *(["35% / 0%"] if name == FIGURE else [])]
    return Table(heading=f"{log}: {what}", columns=columns, rows=rows)


def _significance(log: str, shares: Sequence[float], column) -> Table:  # type: ignore[no-untyped-def]
    rows = []
    corrected = {
        share: holm(
            {
                m: paired_p(column(log, share, "graph", FIGURE), column(log, share, m, FIGURE))
                for m in BASELINES
            }
        )
        for share in shares
    }
    for method in BASELINES:
        row = [method]
        for share in shares:
            pairs = zip(column(log, share, "graph", FIGURE), column(log, share, method, FIGURE), strict=True)
            row.append(f"{p_text(corrected[share][method])} (better in {sum(a < b for a, b in pairs)})")
        rows.append(row)
    heading = f"{log}: graph against the others, corrected p of the relations' error"
    return Table(heading=heading, columns=["method", *(f"{share:.0%}" for share in shares)], rows=rows)


def _labels(log: str, shares: Sequence[float], column) -> Table:  # type: ignore[no-untyped-def]
    rows = [
        [method, *(_scores(log, share, method, column) for share in shares)]
        for method in METHODS
        if any(value > 0.0 for share in shares for value in column(log, share, method, "recall"))
    ]
    heading = f"{log}: moving points, median precision / recall / IoU"
    return Table(heading=heading, columns=["method", *(f"{share:.0%}" for share in shares)], rows=rows)


def _scores(log: str, share: float, method: str, column) -> str:  # type: ignore[no-untyped-def]
    figures = (np.median(column(log, share, method, name)) for name in ("precision", "recall", "iou"))
    return " / ".join(number(float(figure)) for figure in figures)


if __name__ == "__main__":
    sys.exit(main(experiment))
