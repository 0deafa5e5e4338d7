"""Is p_moving a probability? Reliability diagram and expected calibration error."""

import sys

import numpy as np

from experiments import recorded
from experiments.common import Options, Scores, main, run_cells
from experiments.figures import panels, save
from experiments.measures import run_method
from experiments.tables import Table, median_interval, number, write_tables
from slammot_graph.simulation import simulate

LOGS = ("intel", "aces")
SCENARIOS = ("lab", "office", "hall", "crowd")
FULL_SEEDS, QUICK_SCANS = 8, 200
N_SCANS, N_PEOPLE, N_BINS = 2500, 6, 10


def cell(name: str, log: str | None, reference: str | None, seed: int, n_scans: int) -> Scores:
    """Beams, moving beams and sum of p_moving by bin of p_moving."""
    if log is None or reference is None:
        walkers = simulate(name, seed=seed)
        result = run_method(walkers, "graph")
        is_judged = result.is_valid
    else:
        walkers = recorded.with_walkers(log, reference, N_PEOPLE, seed, n_scans)
        result = run_method(walkers, "graph")
        is_judged = result.is_valid & ~recorded.is_of_the_log(walkers, reference)
    p = np.asarray(result.p_moving[is_judged], dtype=np.float64)
    is_moving = walkers.is_moving[: len(result.stamps)][is_judged]
    which = np.minimum((p * N_BINS).astype(np.int64), N_BINS - 1)
    n = np.bincount(which, minlength=N_BINS)
    moving = np.bincount(which, is_moving, minlength=N_BINS)
    total = np.bincount(which, p, minlength=N_BINS)
    called = p[result.is_moving_online[is_judged]]
    right = is_moving[result.is_moving_online[is_judged]]
    return {
        "n": n.tolist(),
        "moving": moving.tolist(),
        "p": total.tolist(),
        "ece": float(np.abs(moving - total).sum() / n.sum()),
        "ece_called": _ece(called, right),
    }


def _ece(p: "np.ndarray", is_moving: "np.ndarray") -> float:
    """Expected calibration error: mean gap between probability and share, weighted by the bins' beams."""
    which = np.minimum((p * N_BINS).astype(np.int64), N_BINS - 1)
    gap = np.bincount(which, is_moving, minlength=N_BINS) - np.bincount(which, p, minlength=N_BINS)
    return float(np.abs(gap).sum() / max(len(p), 1))


def experiment(options: Options) -> None:
    """Reliability of `p_moving` on intel and aces with people injected, and on simulated scenarios."""
    seeds = options.seed_range(FULL_SEEDS, quick=1)
    n_scans = QUICK_SCANS if options.quick else N_SCANS
    cells = {}
    for log in LOGS[:1] if options.quick else LOGS:
        path = str(options.recorded(f"{log}.clf.bz2"))
        reference = recorded.make_reference(log, options, n_scans)
        for seed in seeds:
            cells[f"{log} {seed} {n_scans}"] = {
                "name": log, "log": path, "reference": reference, "seed": seed, "n_scans": n_scans,
            }  # fmt: skip
    for name in SCENARIOS[:1] if options.quick else SCENARIOS:
        for seed in seeds:
            cells[f"{name} {seed} {n_scans}"] = {
                "name": name, "log": None, "reference": None, "seed": seed, "n_scans": n_scans,
            }  # fmt: skip
    scores = run_cells("reliability", cell, cells, options)
    names = list(dict.fromkeys(key.split()[0] for key in cells))
    of = {name: [scores[key] for key in cells if key.split()[0] == name] for name in names}
    rows = []
    figure, ((axes,),) = panels(1, 1, (5.0, 5.0))
    axes.plot([0, 1], [0, 1], color="0.6", linewidth=1.0)
    for name, found in of.items():
        n, moving, p = (np.sum([score[key] for score in found], axis=0) for key in ("n", "moving", "p"))
        is_filled = n >= 100
        axes.plot(p[is_filled] / n[is_filled], moving[is_filled] / n[is_filled], marker="o", label=name)
        ece = float(np.abs(moving - p).sum() / n.sum())
        rows.append(
            [
                name,
                number(ece, 4),
                median_interval([score["ece"] for score in found], 4),
                median_interval([score["ece_called"] for score in found], 3),
                f"{moving.sum() / n.sum():.1%}",
            ]
        )
    axes.set_xlabel("p_moving")
    axes.set_ylabel("share of the beams that hit a person")
    axes.legend()
    save(figure, "reliability", options)
    columns = ["log", "ECE, all runs", "ECE of a run", "ECE among points called moving", "beams on people"]
    notes = [
        f"Expected calibration error over {N_BINS} bins, {len(seeds)} seeds: mean gap between p_moving and the share"
        " of beams that hit a person. In the recorded logs their own people are set aside. The weights were fitted on"
        " seeds from 100 on (`python -m experiments.fit_p_moving`). Figure: figures/reliability.png."
    ]
    write_tables(
        "reliability",
        "Reliability of p_moving",
        notes,
        [Table(heading="Calibration", columns=columns, rows=rows)],
        options,
    )


if __name__ == "__main__":
    sys.exit(main(experiment))
