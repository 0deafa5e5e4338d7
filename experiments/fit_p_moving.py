"""Fit the weights of p_moving: what speaks for a cluster against whether it was a person."""

import sys

import numpy as np
from scipy.optimize import minimize

from experiments import recorded
from experiments.common import Options, Scores, main, run_cells
from experiments.reliability import LOGS, N_PEOPLE, N_SCANS, QUICK_SCANS, SCENARIOS
from experiments.tables import Table, number, write_tables
from slammot_graph import get_method
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import FloatArray
from slammot_graph.detection import reasons
from slammot_graph.detection.base import Detection
from slammot_graph.detection.ellipse_detector import EllipseDetector, EllipseDetectorConfig
from slammot_graph.detection.probability import NAMES, SHARE_OF_STATIC, WEIGHTS, cluster_evidence
from slammot_graph.pipeline import Pipeline, PipelineConfig
from slammot_graph.simulation import SimulatedLog, simulate

FIRST_SEED, FULL_SEEDS = 100, 3
SHRINK = 1e-3
"""Pull of the weights towards zero."""
N_ROUND = 2


class _Watched(EllipseDetector):
    """Keeps the latest detection and the evidence of its clusters."""

    evidence: FloatArray = np.empty((0, len(NAMES)))
    detection: Detection | None = None

    def p_moving(
        self, scan: Scan, detection: Detection, points: FloatArray, predicted_positions: FloatArray
    ) -> FloatArray:
        self.evidence = cluster_evidence(detection, points, scan.ranges, self.grid, predicted_positions)
        self.detection = detection
        return super().p_moving(scan, detection, points, predicted_positions)


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
    assert isinstance(config.detector, EllipseDetectorConfig)
    pipeline = Pipeline(config)
    pipeline.detector = watched = _Watched(config.detector, max_range_m=config.max_range_m)
    evidence, beams, moving = [], [], []
    by_reason = np.zeros((len(reasons.REASONS), 2))
    for scan in walkers:
        step = pipeline.step(scan)
        found = watched.detection
        assert found is not None
        is_person = walkers.is_moving[scan.index]
        is_judged = step.is_valid & ~aside[scan.index]
        is_static = is_judged & ~found.is_moving
        by_reason[:, 0] += np.bincount(found.reason[is_static], minlength=len(by_reason))
        by_reason[:, 1] += np.bincount(found.reason[is_static & is_person], minlength=len(by_reason))
        is_called = is_judged & found.is_moving
        cluster = found.cluster[is_called]
        n = np.bincount(cluster, minlength=found.n_clusters)
        hit = np.bincount(cluster, is_person[is_called], minlength=found.n_clusters)
        evidence += watched.evidence[n > 0].round(3).tolist()
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
