"""False closures put into the joint decision: do they get in, and what do they do to the map."""

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from experiments.common import say
from experiments.freiburg import (
    LoopOptions,
    WatchedRun,
    closure_errors,
    closures_of,
    command_line,
    count_events,
    is_wrong,
    logs_with_relations,
    run_watched,
    spread,
    write_report,
)
from experiments.tables import Table
from slammot_graph import open_log
from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.results import ClosureAttempt
from slammot_graph.core.types import FloatArray
from slammot_graph.evaluation import RelationScores, evaluate_relations, read_relations
from slammot_graph.loop_closure import Closure, LoopCloser, Submap

FIRST_SCANS = 6000
QUICK_SCANS = 2500
SEEDS = (0, 1)
COLUMNS = (
    "false closures",
    "seed",
    "translation [m]",
    "rotation [degrees]",
    "change",
    "within 10%",
    "closures",
    "wrong by the run without",
    "false ones ever taken",
    "false ones at the end",
    "true ones ever rejected as outliers",
    "deciding [ms each]",
    "longest [ms]",
    "run, CPU [s]",
)


@dataclass(frozen=True, kw_only=True)
class FalseOptions(LoopOptions):
    """Options of this experiment.

    Attributes
    ----------
    log : str
        Name of a log with relations.
    whole : bool
        The whole log, not its first 6,000 scans.
    """

    log: str = "intel"
    whole: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Lie:
    """A false closure between two local maps, known by their numbers, with the covariance `of` a true one."""

    target: int
    source: int
    T_target_source: FloatArray
    of: Closure


@dataclass(kw_only=True, eq=False)
class Liar:
    """Tells the lies to a `LoopCloser`, each as soon as its source is finished."""

    lies: Sequence[Lie]
    told: list[Closure] = field(default_factory=list)
    ever_taken: set[int] = field(default_factory=set)
    believed: list[str] = field(default_factory=list)
    ms: list[float] = field(default_factory=list)
    finished: list[Submap] = field(default_factory=list)

    def __call__(self, closer: LoopCloser, submap: Submap) -> tuple[ClosureAttempt, ...]:
        """Put in what is due, as `LoopCloser.consider` does with a closure of its own."""
        attempts = list[ClosureAttempt]()
        self.finished.append(submap)
        for lie in self.lies:
            if lie.source != submap.number:
                continue
            target = self.finished[lie.target].place
            closure = Closure(
                target=target,
                source=submap.place,
                T_target_source=lie.T_target_source,
                cov=lie.of.cov,
                information=lie.of.information,
                overlap=lie.of.overlap,
            )
            self.told.append(closure)
            start = time.process_time()
            nodes = closer.graph.poses()
            cov = closer.config.drift_scale**2 * closer.graph.relative_covariance(
                target.anchor, submap.anchor
            )
            predicted = se2.between(nodes[target.anchor], nodes[submap.anchor])
            attempt = closer.decide(closure, predicted, cov)
            accepted = attempt.status == "accepted"
            attempts.append(attempt)
            if accepted:
                self.believed.append(attempt.text)
            taken = {id(c) for c in accepted_by(closer)}
            self.ever_taken |= {k for k, c in enumerate(self.told) if id(c) in taken}
            if accepted:
                attempts += closer.reject_outliers()
            self.ms.append(1e3 * (time.process_time() - start))
        return tuple(attempts)

    def n_left(self, closer: LoopCloser) -> int:
        """How many of the lies are believed."""
        taken = {id(c) for c in accepted_by(closer)}
        return sum(id(c) in taken for c in self.told)


def accepted_by(closer: LoopCloser) -> list[Closure]:
    """The closures that are believed now."""
    return [closure for closure, _ in closer.accepted]


def lies_at_random(truth: WatchedRun, n: int, rng: np.random.Generator) -> list[Lie]:
    """Pairs from anywhere, said to be the same place: within 3 m and at any angle."""
    submaps, closures = truth.submaps, accepted_by(_closer(truth))
    sources = np.sort(rng.integers(2, len(submaps), n))
    lies = []
    for source in sources:
        target = int(rng.integers(0, source - 1))
        T = np.append(rng.uniform(-3.0, 3.0, 2), rng.uniform(-np.pi, np.pi))
        of = closures[rng.integers(len(closures))]
        lies.append(Lie(target=target, source=int(source), T_target_source=T, of=of))
    return lies


def lies_nearby(truth: WatchedRun, n: int, rng: np.random.Generator) -> list[Lie]:
    """Pairs that the loop closing may look at, 0.6 to 3 m and up to 20 degrees off the truth."""
    pairs = _near_pairs(truth)
    closures = accepted_by(_closer(truth))
    lies = []
    for k in np.sort(rng.choice(len(pairs), n, replace=len(pairs) < n)):
        angle, length = rng.uniform(-np.pi, np.pi), rng.uniform(0.6, 3.0)
        off = np.array([length * np.cos(angle), length * np.sin(angle), rng.uniform(-0.35, 0.35)])
        target, source = pairs[k]
        T = se2.compose(_between(truth, target, source), off)
        of = closures[rng.integers(len(closures))]
        lies.append(Lie(target=target, source=source, T_target_source=T, of=of))
    return lies


def lies_in_chorus(truth: WatchedRun, n: int, length_m: float, rng: np.random.Generator) -> list[Lie]:
    """Pairs in groups of neighbours, all off by the same displacement in the map, as in corridors that look alike."""
    pairs = _near_pairs(truth)
    closures = accepted_by(_closer(truth))
    n_groups = 3
    chosen: list[int] = []
    for group in range(n_groups):
        share = n // n_groups + (group < n % n_groups)
        first = len(pairs) * group // n_groups
        chosen += range(first, min(first + share, len(pairs)))
    angle = rng.uniform(-np.pi, np.pi)
    T_map_off = np.array([length_m * np.cos(angle), length_m * np.sin(angle), 0.0])
    nodes = truth.result.nodes
    submaps = truth.submaps
    lies = []
    for k in chosen:
        target, source = pairs[k]
        moved = nodes[submaps[source].anchor] + T_map_off
        T = se2.between(nodes[submaps[target].anchor], moved)
        of = closures[rng.integers(len(closures))]
        lies.append(Lie(target=target, source=source, T_target_source=T, of=of))
    return lies


def experiment(options: FalseOptions) -> None:
    """False closures put into the joint decision of loop closing."""
    found = logs_with_relations(options)
    if options.log not in found:
        raise InputError(f"no log {options.log} with relations; there are {', '.join(found)}")
    path, relations_path = found[options.log]
    log, relations = open_log(path), read_relations(relations_path)
    max_scans = None if options.whole else QUICK_SCANS if options.quick else FIRST_SCANS

    truth = run_watched(log, max_scans=max_scans)
    if not accepted_by(_closer(truth)):
        raise InputError(f"{path}: no closure in its first {max_scans} scans, so there is nothing to imitate")
    base = evaluate_relations(truth.result.stamps, truth.result.T_map_base, relations)
    rows = [_row("none", "-", truth, truth, base, base, None)]
    say(f"false_closures: {' | '.join(rows[-1])}")
    for name, make in _conditions(options.quick):
        for seed in SEEDS[:1] if options.quick else SEEDS:
            liar = Liar(lies=make(truth, np.random.default_rng(seed)))
            run = run_watched(log, max_scans=max_scans, after_consider=liar)
            scores = evaluate_relations(run.result.stamps, run.result.T_map_base, relations)
            rows.append(_row(name, str(seed), run, truth, scores, base, liar))
            say(f"false_closures: {' | '.join(rows[-1])}")
            for text in liar.believed:
                say(f"false_closures:   false {text}")
    n_scans = len(truth.result.stamps)
    intro = (
        f"{options.log}, {n_scans} scans. False closures are handed to `LoopCloser.decide` after the verification, as"
        " soon as the later local map is finished, each with the covariance of a true one. random: between any"
        " two local maps, said to be within 3 m of each other at any angle. nearby: between local maps less than"
        " 8 m apart, 0.6 to 3 m and up to 20 degrees off. aliased: in three groups of neighbouring local maps, all"
        " off by the same displacement in the map, so that they agree with each other. `change` is that of the mean"
        " translation error. `wrong by the run without`: closures in the graph at the end that lie more than"
        " 0.5 m or 5 degrees from the trajectory of the run without false ones."
    )
    table = Table(heading=options.log, columns=COLUMNS, rows=rows)
    more = f"{'' if options.log == 'intel' else f' --log {options.log}'}{' --whole' if options.whole else ''}"
    write_report("false_closures", options, "False closures put in", [intro], [table], more)


Maker = Callable[[WatchedRun, np.random.Generator], list[Lie]]


def _conditions(quick: bool) -> list[tuple[str, Maker]]:
    def at_random(n: int) -> Maker:
        return lambda truth, rng: lies_at_random(truth, n, rng)

    def aliased(distance_m: float) -> Maker:
        return lambda truth, rng: lies_in_chorus(truth, 15, distance_m, rng)

    conditions: list[tuple[str, Maker]] = [(f"{n} random", at_random(n)) for n in (10, 30, 60)]
    conditions.append(("30 nearby", lambda truth, rng: lies_nearby(truth, 30, rng)))
    conditions += [(f"15 aliased, {d:g} m", aliased(d)) for d in (1.0, 2.0, 3.0)]
    return conditions[:1] + conditions[-1:] if quick else conditions


def _row(
    name: str,
    seed: str,
    run: WatchedRun,
    truth: WatchedRun,
    scores: RelationScores,
    base: RelationScores,
    liar: Liar | None,
) -> list[str]:
    change = scores.translation_m.mean / base.translation_m.mean - 1.0
    turn_change = scores.rotation_deg.mean / base.rotation_deg.mean - 1.0
    closures = closures_of(run.result)
    n_wrong = int(is_wrong(*closure_errors(closures, truth.result.nodes)).sum())
    n_back = count_events(run.result, "closure rejected")
    told = [] if liar is None else liar.told
    n_false_back = 0 if liar is None else len(liar.ever_taken) - liar.n_left(_closer(run))
    return [
        name,
        seed,
        spread(scores.translation_m, 4),
        spread(scores.rotation_deg, 3),
        f"{100 * change:+.1f}%",
        "yes" if max(change, turn_change) <= 0.1 else "**no**",
        str(len(closures)),
        str(n_wrong),
        f"{len(liar.ever_taken)} of {len(told)}" if liar else "-",
        str(liar.n_left(_closer(run))) if liar else "-",
        str(n_back - n_false_back),
        f"{np.mean(liar.ms):.1f}" if liar and liar.ms else "-",
        f"{np.max(liar.ms):.0f}" if liar and liar.ms else "-",
        f"{run.cpu_s:.1f}",
    ]


def _closer(run: WatchedRun) -> LoopCloser:
    if run.closer is None:
        raise InputError("the method does not close loops")
    return run.closer


def _near_pairs(truth: WatchedRun) -> list[tuple[int, int]]:
    """(target, source) of local maps less than 8 m apart with some path between, the nearest of each source."""
    submaps = truth.submaps
    nodes = truth.result.nodes
    centres = np.array([se2.transform(nodes[s.anchor], s.centre[None, :])[0] for s in submaps])
    path_m = np.array([s.path_m for s in submaps])
    pairs = []
    for source in range(len(submaps)):
        distance_m = np.hypot(*(centres[:source] - centres[source]).T)
        distance_m[path_m[source] - path_m[:source] < 8.0] = np.inf
        if distance_m.size and distance_m.min() < 8.0:
            pairs.append((int(np.argmin(distance_m)), source))
    return pairs


def _between(truth: WatchedRun, target: int, source: int) -> FloatArray:
    nodes, submaps = truth.result.nodes, truth.submaps
    return se2.between(nodes[submaps[target].anchor], nodes[submaps[source].anchor])


if __name__ == "__main__":
    sys.exit(command_line(experiment, FalseOptions, None))
