"""Two methods of place recognition: branch and bound over score grids, and ORB features of density maps.

Over 400 lines because two methods of place recognition are compared on the same pairs by the same figures.
"""

import importlib
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np

from experiments.common import Options, Scores, main, run_cells
from experiments.freiburg import WRONG_DEG, WRONG_M
from experiments.tables import Table, number, write_tables
from slammot_graph import Run, open_log
from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.types import FloatArray
from slammot_graph.localization import ScanToMapConfig
from slammot_graph.logs import LaserLog
from slammot_graph.loop_closure import LoopCloser, LoopClosureConfig, Submap
from slammot_graph.loop_closure.submap import PreparedSubmap
from slammot_graph.loop_closure.verification import SearchWindow, Verifier
from slammot_graph.pipeline import PipelineConfig
from slammot_graph.simulation import simulate

SIMULATED, QUICK_LOG, RECORDED = ("building", "office"), "lab", "intel"
N_SCANS = 6000
"""Of the recorded log."""
N_PAIRS, QUICK_PAIRS = 150, 8
"""At most so many positives, and so many negatives, of each log."""
PATH_M, NEAR_M, FAR_M = 8.0, 2.0, 10.0
SAME_RAD, OPPOSITE_RAD = math.radians(60.0), math.radians(120.0)
STRATA = ("same", "opposite", "negative")
DRIFTS_M, DRIFT_RAD = (1.0, 3.0, 6.0), math.radians(20.0)
ELSEWHERE = "elsewhere"
"""In place of a drift: negatives whose centres are believed to lie on each other."""
MAX_INLIERS = 40
MIN_INLIERS, OWN_INLIERS = 3, 5
"""What is asked of RANSAC at least, and by the package itself."""
ORB_EDGE = 40
"""Margin around a density map [cells]: ORB finds nothing within 31 of the border."""

Setting = tuple[float, float, int, str]
"""Resolution [m], density threshold, Hamming threshold, points."""
SETTINGS: tuple[Setting, ...] = (
    (0.1, 0.05, 50, "thin"),
    (0.1, 0.05, 70, "thin"),
    (0.2, 0.05, 35, "thin"),
    (0.2, 0.05, 50, "thin"),
    (0.2, 0.05, 60, "thin"),
    (0.2, 0.05, 70, "thin"),
    (0.2, 0.3, 50, "thin"),
    (0.3, 0.05, 50, "thin"),
    (0.5, 0.05, 50, "thin"),
    (0.2, 0.05, 50, "all"),
    (0.2, 0.05, 50, "thin, no margin"),
    (0.5, 0.05, 50, "thin, no margin"),
)
QUICK_SETTINGS = (SETTINGS[3], SETTINGS[-1])

COLUMNS = (
    "method",
    "drift [m]",
    "found, same direction",
    "found, opposite",
    "recall",
    "accepted",
    "right (precision)",
    "median [ms]",
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Places:
    """The local maps of a run, with the true poses of their anchors.

    Attributes
    ----------
    closer : LoopCloser
    T_world_anchors : (n, 3) array
    """

    closer: LoopCloser
    T_world_anchors: FloatArray

    def between(self, target: int, source: int) -> FloatArray:
        """True pose of a local map's anchor in another one's frame."""
        return se2.between(self.T_world_anchors[target], self.T_world_anchors[source])


@dataclass(frozen=True, kw_only=True, eq=False)
class Answer:
    """What a method says about a pair: a relative pose or none, how sure it is, and how long it took."""

    T_target_source: FloatArray | None
    n_inliers: int = 0
    ms: float = 0.0


class Probe(Verifier):
    """A verifier that is asked about one pair, with the search's pose kept, or given in its place."""

    given: FloatArray | None = None
    found: FloatArray | None = None

    def _search(
        self,
        prepared: PreparedSubmap,
        points: FloatArray,
        centre: FloatArray,
        window: SearchWindow,
        excluded: FloatArray | None,
        min_score: float,
        out: FloatArray,
    ) -> int:
        if self.given is not None:
            if excluded is not None:
                return 0
            out[:] = self.given
            return 1
        score = super()._search(prepared, points, centre, window, excluded, min_score, out)
        if excluded is None:
            self.found = out.copy() if score else None
        elif score:
            self.found = None  # ambiguous
        return score

    def ask(
        self, target: Submap, source: Submap, believed: FloatArray, given: FloatArray | None = None
    ) -> tuple[Answer, Answer]:
        """Search (or take the given pose) and verify; the search's answer without and with verification.

        The target is ready beforehand, the source is new.
        """
        self.prepare(target)
        self._prepared.pop(source.number, None)
        new = replace(source)
        self.given, self.found = given, given
        most_m, most_rad = self.config.max_search_m, self.config.max_search_rad
        window = SearchWindow(reach_m=most_m, distance_m=most_m, rotation_rad=most_rad)
        start = time.perf_counter()
        closure = self.verify(target, new, believed, window)
        ms = 1e3 * (time.perf_counter() - start)
        verified = None if isinstance(closure, str) else closure.T_target_source
        return Answer(T_target_source=self.found, ms=ms), Answer(T_target_source=verified, ms=ms)


def map_closures() -> Any:
    """Import the package; InputError says how to get it."""
    try:
        return importlib.import_module("map_closures.map_closures")
    except ImportError:
        raise InputError(
            'place_recognition needs map_closures: pip install ".[places]" (it asks for numpy < 2.3;'
            " with --no-deps it leaves the numpy that is there)"
        ) from None


def density_points(submap: Submap, points: str, resolution_m: float) -> FloatArray:
    """(m, 3) points of a local map for its density map, z = 0; two lone points far out make the margin."""
    kind, _, no_margin = points.partition(", ")
    if kind == "thin":
        flat, _ = submap.points_and_normals
    else:
        poses = zip(submap.T_anchor_keyframes, submap.keyframes, strict=True)
        flat = np.vstack([se2.transform(T, keyframe.points_base) for T, keyframe in poses])
    if not no_margin:
        margin = ORB_EDGE * resolution_m
        flat = np.vstack([flat, flat.min(axis=0) - margin, flat.max(axis=0) + margin])
    return np.column_stack([flat, np.zeros(len(flat))])


def ask_density_maps(package: Any, target: Submap, source: Submap, setting: Setting) -> Answer:
    """Pose of `source` in `target` by the features of their density maps; the target's are ready beforehand."""
    resolution_m, density, hamming, points = setting
    config = package.MapClosuresConfig(
        density_map_resolution=resolution_m,
        density_threshold=density,
        hamming_distance_threshold=hamming,
        inliers_threshold=MIN_INLIERS,
    )
    finder = package.MapClosures(config)
    finder.get_best_closure(0, density_points(target, points, resolution_m))
    new = replace(source)
    start = time.perf_counter()
    # the package passes over the last few local maps before the query
    found = finder.get_best_closure(100, density_points(new, points, resolution_m))
    ms = 1e3 * (time.perf_counter() - start)
    if found.number_of_inliers < MIN_INLIERS:
        return Answer(T_target_source=None, ms=ms)
    pose = np.linalg.inv(np.asarray(found.pose))  # of the target in the source's frame
    T = np.array([pose[0, 3], pose[1, 3], math.atan2(pose[1, 0], pose[0, 0])])
    return Answer(T_target_source=T, n_inliers=int(found.number_of_inliers), ms=ms)


def collect(name: str, path: str | None, n_scans: int | None) -> Places:
    """Run `graph` over (the first scans of) a log and give its local maps; truth: the simulation's, or the graph's."""
    log: LaserLog = open_log(path) if path else simulate(name, seed=0)
    keep_all = PipelineConfig(localizer=ScanToMapConfig(closure=LoopClosureConfig(known_overlap=1.0)))
    run = Run(log, "graph", config=keep_all)
    steps = iter(run)
    for _ in islice(steps, n_scans):
        pass
    steps.close()  # type: ignore[attr-defined]
    result = run.result()
    nodes = result.nodes if path else log.T_world_base[result.node_scans]  # type: ignore[attr-defined]
    pipeline: Any = run.pipeline
    closer = pipeline.localizer.closer
    return Places(closer=closer, T_world_anchors=nodes[[submap.anchor for submap in closer.submaps]])


def draw_pairs(
    places: Places, n_pairs: int, rng: np.random.Generator
) -> tuple[list[tuple[str, int, int]], dict[str, int]]:
    """Draw (stratum, target, source), half of the positives of each direction if there are so many.

    Also tells how many pairs there are to draw from.
    """
    T = places.T_world_anchors
    submaps = places.closer.submaps
    centres = np.array([se2.transform(a, s.centre[None, :])[0] for a, s in zip(T, submaps, strict=True)])
    path_m = np.array([submap.path_m for submap in submaps])
    distance_m = np.hypot(*(centres[:, None] - centres[None]).transpose(2, 0, 1))
    driven_m = path_m[None] - path_m[:, None]
    turned = np.abs(se2.wrap_angle(T[:, 2][:, None] - T[:, 2][None]))
    near = (distance_m < NEAR_M) & (driven_m > PATH_M)
    chosen = {
        "same": np.argwhere(near & (turned < SAME_RAD)),
        "opposite": np.argwhere(near & (turned > OPPOSITE_RAD)),
        "negative": np.argwhere((distance_m > FAR_M) & (driven_m > 0.0)),
    }
    n_same, n_opposite = len(chosen["same"]), len(chosen["opposite"])
    sizes = {
        "same": max(n_pairs // 2, n_pairs - n_opposite),
        "opposite": max(n_pairs // 2, n_pairs - n_same),
        "negative": n_pairs,
    }
    pairs = []
    for stratum in STRATA:
        kept = np.sort(rng.permutation(len(chosen[stratum]))[: sizes[stratum]])
        pairs += [(stratum, int(a), int(b)) for a, b in chosen[stratum][kept]]
    return pairs, {stratum: len(chosen[stratum]) for stratum in STRATA}


def disturbed(T: FloatArray, drift_m: float, rng: np.random.Generator) -> FloatArray:
    """Carry a relative pose off by a distance in a random direction, and turn it by up to 20 degrees."""
    direction = rng.uniform(-np.pi, np.pi)
    turn = rng.uniform(-DRIFT_RAD, DRIFT_RAD)
    off: FloatArray = T + np.array([drift_m * np.cos(direction), drift_m * np.sin(direction), turn])
    return off


def is_right(answer: Answer, T_true: FloatArray) -> bool:
    """Tell whether an answer lies within 0.5 m and 5 degrees of the truth."""
    if answer.T_target_source is None:
        return False
    x, y, turn = se2.between(T_true, answer.T_target_source)
    return bool(math.hypot(x, y) <= WRONG_M and math.degrees(abs(turn)) <= WRONG_DEG)


def summary(
    strata: Sequence[str], answers: Sequence[Answer], truth: Sequence[FloatArray], min_inliers: int = 0
) -> dict[str, float]:
    """Counts of accepted and of right answers, in all and by stratum, and the median time."""
    accepted = [a.T_target_source is not None and a.n_inliers >= min_inliers for a in answers]
    right = [ok and is_right(a, T) for ok, a, T in zip(accepted, answers, truth, strict=True)]
    counts = {
        stratum: sum(ok for ok, own in zip(right, strata, strict=True) if own == stratum)
        for stratum in STRATA
    }
    ms = float(np.median([a.ms for a in answers])) if answers else math.nan
    return {"accepted": sum(accepted), "right": sum(right), **counts, "ms": ms}


def cell(
    log: str,
    path: str | None,
    n_scans: int | None,
    n_pairs: int,
    settings: Sequence[Setting],
) -> Scores:
    """Ask both methods about the pairs of one log."""
    package = map_closures()
    places = collect(log, path, n_scans)
    submaps = [replace(submap, component=0) for submap in places.closer.submaps]
    closer = places.closer
    probe = Probe(closer.config, closer.verifier._field.config)
    rng = np.random.default_rng(0)
    pairs, there_are = draw_pairs(places, n_pairs, rng)
    strata = [stratum for stratum, _, _ in pairs]
    truth = [places.between(target, source) for _, target, source in pairs]
    if pairs:  # the first call compiles
        probe.ask(submaps[pairs[0][1]], submaps[pairs[0][2]], truth[0])
    searches = {}
    for drift_m in DRIFTS_M:
        believed = [disturbed(T, drift_m, rng) for T in truth]
        answers = [probe.ask(submaps[a], submaps[b], T) for (_, a, b), T in zip(pairs, believed, strict=True)]
        searches[f"{drift_m:g}"] = _both(strata, answers, truth)
    negatives = [(a, b, T) for (stratum, a, b), T in zip(pairs, truth, strict=True) if stratum == "negative"]
    answers = [
        probe.ask(submaps[a], submaps[b], disturbed(_upon(submaps[a], submaps[b], T), 1.0, rng))
        for a, b, T in negatives
    ]
    searches[ELSEWHERE] = _both(["negative"] * len(negatives), answers, [T for _, _, T in negatives])
    density = {}
    for setting in settings:
        found = [ask_density_maps(package, submaps[a], submaps[b], setting) for _, a, b in pairs]
        verified = []
        for (_, a, b), answer in zip(pairs, found, strict=True):
            T = answer.T_target_source
            if T is None:
                verified.append(answer)
                continue
            _, after = probe.ask(submaps[a], submaps[b], T, given=T)
            verified.append(replace(after, ms=answer.ms + after.ms))
        thresholds = range(MIN_INLIERS, MAX_INLIERS + 1)
        density[setting_name(setting)] = {
            "alone": {str(n): summary(strata, found, truth, n) for n in thresholds},
            "verified": summary(strata, verified, truth),
        }
    n_drawn = {stratum: strata.count(stratum) for stratum in STRATA}
    return {"n": n_drawn, "there_are": there_are, "search": searches, "density": density}


def _both(
    strata: Sequence[str], answers: Sequence[tuple[Answer, Answer]], truth: Sequence[FloatArray]
) -> dict[str, dict[str, float]]:
    return {
        "alone": summary(strata, [alone for alone, _ in answers], truth),
        "verified": summary(strata, [verified for _, verified in answers], truth),
    }


def _upon(target: Submap, source: Submap, T: FloatArray) -> FloatArray:
    """Pose of `source` with the heading of `T` that lays its centre onto the target's."""
    turned = np.array([0.0, 0.0, T[2]])
    place = target.centre - se2.transform(turned, source.centre[None, :])[0]
    return np.array([*place, T[2]])


def setting_name(setting: Setting) -> str:
    """A setting in words."""
    resolution_m, density, hamming, points = setting
    return f"{resolution_m:g} m, density {density:g}, Hamming {hamming}, {points}"


def share(n: float, of: float) -> float:
    """Share, NaN of nothing."""
    return n / of if of else math.nan


def percent(n: float, of: float) -> str:
    """Count and share as text, "-" of nothing."""
    return f"{n:.0f} of {of:.0f} ({100 * n / of:.0f}%)" if of else "-"


def recall(score: dict[str, float], n: dict[str, int]) -> float:
    """Share of the positives whose pose was found."""
    return share(score["same"] + score["opposite"], n["same"] + n["opposite"])


def is_precise(score: dict[str, float]) -> bool:
    """Tell whether all that was accepted is right."""
    return score["right"] == score["accepted"]


def least_precise(density: dict[str, Any]) -> tuple[int, dict[str, float]] | None:
    """The fewest inliers at which all that is accepted is right, and what is found with them; None if nothing is."""
    for n in range(MIN_INLIERS, MAX_INLIERS + 1):
        score = density["alone"][str(n)]
        if is_precise(score):
            return (n, score) if score["accepted"] else None
    return None


def best_setting(scores: dict[str, Scores], names: Sequence[str]) -> str:
    """The setting with the highest mean recall after verification, the earlier one of equals."""

    def mean(name: str) -> float:
        found = [recall(own["density"][name]["verified"], own["n"]) for own in scores.values()]
        found = [value for value in found if not math.isnan(value)]
        return float(np.mean(found)) if found else 0.0

    return max(names, key=mean)


def row(method: str, drift: str, score: dict[str, float], n: dict[str, int]) -> list[str]:
    """One line of a log's table."""
    has_positives = drift != ELSEWHERE
    found = score["same"] + score["opposite"]
    return [
        method,
        drift,
        percent(score["same"], n["same"]) if has_positives else "-",
        percent(score["opposite"], n["opposite"]) if has_positives else "-",
        percent(found, n["same"] + n["opposite"]) if has_positives else "-",
        f"{score['accepted']:.0f}",
        percent(score["right"], score["accepted"]),
        number(score["ms"], 1),
    ]


def log_table(log: str, own: Scores, setting: str) -> Table:
    """All methods on one log."""
    n, density = own["n"], own["density"][setting]
    rows = []
    for drift, both in own["search"].items():
        rows.append(row("search alone", drift, both["alone"], n))
        rows.append(row("search, verified (ours)", drift, both["verified"], n))
    default = density["alone"][str(OWN_INLIERS)]
    rows.append(row(f"density maps, {OWN_INLIERS} inliers", "any", default, n))
    if least := least_precise(density):
        rows.append(row(f"density maps, {least[0]} inliers (least at full precision)", "any", least[1], n))
    rows.append(row("density maps, verified", "any", density["verified"], n))
    drawn = ", ".join(f"{n[s]} of {own['there_are'][s]} {s}" for s in STRATA)
    return Table(heading=f"{log} (pairs: {drawn})", columns=COLUMNS, rows=rows)


def settings_table(scores: dict[str, Scores], names: Sequence[str], best: str) -> Table:
    """Recall of all settings of the density maps, alone at full precision and verified."""
    rows = []
    for name in names:
        cells = [f"**{name}**" if name == best else name]
        for own in scores.values():
            density, n = own["density"][name], own["n"]
            least = least_precise(density)
            verified = density["verified"]
            cells += [
                f"{100 * recall(least[1], n):.0f}% ({least[0]} inliers)" if least else "0%",
                f"{100 * recall(verified, n):.0f}% (wrong: {verified['accepted'] - verified['right']:.0f})",
                number(density["alone"][str(OWN_INLIERS)]["ms"], 1),
            ]
        rows.append(cells)
    columns = ["setting", *(f"{log}, {what}" for log in scores for what in ("alone", "verified", "[ms]"))]
    return Table(heading="Settings of the density maps: recall", columns=columns, rows=rows)


def conclusion(scores: dict[str, Scores], setting: str) -> str:
    """Which method finds more at full precision, log by log; ours has to have no wrong answer elsewhere either."""
    said = []
    for log, own in scores.items():
        n, density = own["n"], own["density"][setting]
        least = least_precise(density)
        theirs = recall(least[1], n) if least else 0.0
        if is_precise(density["verified"]):
            theirs = max(theirs, recall(density["verified"], n))
        verified = {drift: both["verified"] for drift, both in own["search"].items()}
        ours = {drift: recall(score, n) for drift, score in verified.items() if drift != ELSEWHERE}
        wrong = [
            f"{score['accepted'] - score['right']:.0f} at {drift}{'' if drift == ELSEWHERE else ' m'}"
            for drift, score in verified.items()
            if not is_precise(score)
        ]
        figures = ", ".join(f"{100 * value:.0f}% at {drift} m" for drift, value in ours.items())
        verdict = "ours is not at full precision" if wrong else _verdict(list(ours.values()), theirs)
        text = f"{log}: {verdict} (ours {figures}; density maps {100 * theirs:.0f}%)"
        said.append(f"{text}, wrong answers of ours: {', '.join(wrong)}" if wrong else text)
    return "**Recall at full precision.** " + ". ".join(said) + "."


def _verdict(ours: Sequence[float], theirs: float) -> str:
    if min(ours) > theirs:
        return "the search finds more"
    if max(ours) < theirs:
        return "density maps find more"
    return "it depends on the drift"


def experiment(options: Options) -> None:
    """Compare search over score grids with features of density maps where drift is larger than the search radius."""
    map_closures()
    settings = QUICK_SETTINGS if options.quick else SETTINGS
    n_pairs = QUICK_PAIRS if options.quick else N_PAIRS
    logs: dict[str, tuple[str | None, int | None]]
    if options.quick:
        logs = {QUICK_LOG: (None, None)}
    else:
        logs = dict.fromkeys(SIMULATED, (None, None))
        logs[RECORDED] = (str(options.recorded(f"{RECORDED}.clf.bz2")), N_SCANS)
    cells = {
        f"{log} {n_scans or 'all'} {n_pairs} {len(settings)}": {
            "log": log,
            "path": path,
            "n_scans": n_scans,
            "n_pairs": n_pairs,
            "settings": settings,
        }
        for log, (path, n_scans) in logs.items()
    }
    computed = run_cells("place_recognition", cell, cells, options)
    scores = dict(zip(logs, computed.values(), strict=True))
    names = [setting_name(setting) for setting in settings]
    best = best_setting(scores, names)
    notes = [
        conclusion(scores, best),
        "",
        f"Pairs of local maps. Positives: more than {PATH_M:g} m of path between, true centres within {NEAR_M:g} m,"
        " anchors' headings less than 60 degrees apart (same direction) or more than 120 (opposite). Negatives:"
        f" centres more than {FAR_M:g} m apart; laser ranges overlap in some of them, so that a right answer is"
        f" possible. Right: within {WRONG_M:g} m and {WRONG_DEG:g} degrees of the truth, which is the simulation's,"
        " of the recorded log the final graph's (so it is made by the closures of our own method). Pairs of one log"
        " share walls, and are not independent.",
        "",
        "search (ours): branch and bound within 8 m and 0.8 rad of the believed pose, refused if ambiguous, then"
        " the closer's own verification. The believed pose is the true one displaced by the drift and turned by"
        f" up to 20 degrees; `{ELSEWHERE}`: negatives believed to lie 1 m from each other, centre to centre."
        " `search alone`: the same without verification, with the time of both. The closer itself searches as far as"
        " its covariance says, and its joint decision comes after the verification: a wrong answer here is one that"
        " the graph's belief would still have to refuse.",
        "",
        "density maps: map-closures (Gupta et al. 2024), pair by pair, z = 0, without a believed pose, so that"
        f" drift is all the same to it. Points: one for each 5 cm (thin) or all; a margin of {ORB_EDGE} cells, since"
        f" ORB looks at nothing within 31 of the border. Setting `{best}` has the highest mean recall after"
        " verification; it and the number of inliers at full precision are chosen after the fact on the same pairs,"
        " which favours this method; that the local maps are small (a few metres of path) does not."
        f" `verified`: at least {MIN_INLIERS} inliers, then the verification of ours from that pose.",
        "",
        "Times: the target is ready beforehand, the source is new; under the load of all processes.",
    ]
    tables = [log_table(log, own, best) for log, own in scores.items()]
    tables.append(settings_table(scores, names, best))
    write_tables("place_recognition", "Two methods of place recognition", notes, tables, options)


if __name__ == "__main__":
    sys.exit(main(experiment))
