"""Fit the weights of p_moving: what speaks for a cluster against whether it was a person."""

import sys
from typing import Any
from unittest.mock import patch

import numpy as np
from scipy.optimize import minimize

from experiments import recorded
from experiments.common import Options, Scores, main, run_cells
from experiments.reliability import LOGS, N_PEOPLE, N_SCANS, QUICK_SCANS, SCENARIOS
from experiments.tables import Table, number, write_tables
from slammot_graph import get_method
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.detection import probability, reasons
from slammot_graph.detection.ellipse_test import Detection
from slammot_graph.detection.probability import NAMES, SHARE_OF_STATIC, WEIGHTS, cluster_evidence
from slammot_graph.pipeline import Pipeline, PipelineConfig
from slammot_graph.simulation import SimulatedLog, simulate

FIRST_SEED, FULL_SEEDS = 100, 3
SHRINK = 1e-3
"""Pull of the weights towards zero."""
N_ROUND = 2


class _Evidence:
    """Keeps what `cluster_evidence` said of a scan's clusters: one call a scan, none where there are no clusters."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        self.evidence: FloatArray = np.empty((0, len(probability.NAMES)))
        self.cluster: IntArray = np.empty(0, dtype=np.int64)

    def __call__(self, detection: Detection, *arguments: Any) -> FloatArray:
        self.cluster = detection.cluster
        self.evidence = cluster_evidence(detection, *arguments)
        return self.evidence


def cell(name: str, log: str | None, reference: str | None, seed: int, n_scans: int) -> Scores:
    """Evidence of all clusters with their beams and those on people; beams and moving ones by reason."""
    if log is None or reference is None:
        walkers: SimulatedLog = simulate(name, seed=seed)
        aside = np.zeros_like(walkers.is_moving)
    else:
        walkers = recorded.with_walkers(log, reference, N_PEOPLE, seed, n_scans)
        aside = recorded.is_of_the_log(walkers, reference)
    config = get_method("graph").config
    assert isinstance(config, PipelineConfig)
    pipeline = Pipeline(config)
    kept = _Evidence()
    evidence: list[list[float]] = []
    beams: list[int] = []
    moving: list[float] = []
    by_reason = np.zeros((len(reasons.REASONS), 2))
    for scan in walkers:
        kept.forget()
        with patch.object(probability, "cluster_evidence", kept):
            step = pipeline.step(scan)
        is_person = walkers.is_moving[scan.index]
        is_judged = step.is_valid & ~aside[scan.index]
        is_static = is_judged & ~step.is_moving
        by_reason[:, 0] += np.bincount(step.reason[is_static], minlength=len(by_reason))
        by_reason[:, 1] += np.bincount(step.reason[is_static & is_person], minlength=len(by_reason))
        is_called = is_judged & step.is_moving
        if not len(kept.evidence):
            continue
        cluster = kept.cluster[is_called]
        n = np.bincount(cluster, minlength=len(kept.evidence))
        hit = np.bincount(cluster, is_person[is_called], minlength=len(kept.evidence))
        evidence += kept.evidence[n > 0].round(3).tolist()
        beams += n[n > 0].tolist()
        moving += hit[n > 0].tolist()
    pipeline.close()
    return {"evidence": evidence, "beams": beams, "moving": moving, "by_reason": by_reason.tolist()}


def fit(evidence: FloatArray, beams: FloatArray, moving: FloatArray) -> FloatArray:
    """Weights of the logistic model by maximum likelihood, clusters weighted by `beams`."""

    def loss(weights: FloatArray) -> tuple[float, FloatArray]:
        z = evidence @ weights
        p = 1.0 / (1.0 + np.exp(-z))
        shrink = SHRINK * np.concatenate([[0.0], weights[1:]])
        value = float((beams * np.logaddexp(0.0, z) - moving * z).sum() / beams.sum())
        gradient = evidence.T @ (beams * p - moving) / beams.sum() + shrink
        return value + 0.5 * float(shrink @ weights), gradient

    return np.asarray(minimize(loss, WEIGHTS, jac=True, method="BFGS").x)


def experiment(options: Options) -> None:
    """Weights of p_moving from intel and aces with people injected and from simulated scenarios, logs alike."""
    seeds = [FIRST_SEED + seed for seed in options.seed_range(FULL_SEEDS, quick=1)]
    n_scans = QUICK_SCANS if options.quick else N_SCANS
    cells = {}
    for name in SCENARIOS[:1] if options.quick else (*LOGS, *SCENARIOS):
        path = reference = None
        if name in LOGS:
            path = str(options.recorded(f"{name}.clf.bz2"))
            reference = recorded.make_reference(name, options, n_scans)
        for seed in seeds:
            cells[f"{name} {seed} {n_scans}"] = {
                "name": name, "log": path, "reference": reference, "seed": seed, "n_scans": n_scans,
            }  # fmt: skip
    scores = run_cells("fit_p_moving", cell, cells, options)
    evidence, beams, moving = [], [], []
    by_reason = np.zeros((len(reasons.REASONS), 2))
    for found in scores.values():
        n = np.array(found["beams"], dtype=np.float64)
        share = 1.0 / max(n.sum(), 1.0)  # each log counts the same
        evidence.append(np.array(found["evidence"]).reshape(-1, len(NAMES)))
        beams.append(share * n)
        moving.append(share * np.array(found["moving"], dtype=np.float64))
        by_reason += np.array(found["by_reason"])
    weights = fit(np.vstack(evidence), np.concatenate(beams), np.concatenate(moving))
    rows = [
        [name, number(new, N_ROUND), number(old, N_ROUND)]
        for name, new, old in zip(NAMES, weights, WEIGHTS, strict=True)
    ]
    static = [
        [reasons.REASONS[k], f"{int(n)}", number(m / n, 4), number(SHARE_OF_STATIC[k], 4)]
        for k, (n, m) in enumerate(by_reason)
        if n > 0 and k in SHARE_OF_STATIC
    ]
    tables = [
        Table(heading="Weights of a cluster's evidence", columns=["", "fitted", "in use"], rows=rows),
        Table(
            heading="Points called static: share on people",
            columns=["reason", "beams", "found", "in use"],
            rows=static,
        ),
    ]
    notes = [
        f"{len(seeds)} seeds from {FIRST_SEED} on of {', '.join(dict.fromkeys(k.split()[0] for k in cells))}."
    ]
    write_tables("fit_p_moving", "Weights of p_moving", notes, tables, options)


if __name__ == "__main__":
    sys.exit(main(experiment))
