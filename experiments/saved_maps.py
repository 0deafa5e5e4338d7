"""Later runs in a saved map: continued, merged, started anywhere in it, and with the furniture moved."""

import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from experiments.common import Options, Scores, main, run_cells
from experiments.tables import Table, number, write_tables
from slammot_graph import MapStart, Pipeline, PipelineConfig, Run, SavedMap, open_log
from slammot_graph.core import se2
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.diagnosis import as_mounted
from slammot_graph.evaluation import evaluate_relations, read_relations
from slammot_graph.saved_maps import closures_between_runs, merge_maps, moved_trajectory
from slammot_graph.simulation import SimulatedLog, simulate
from slammot_graph.simulation.furniture import with_moved_furniture
from slammot_graph.simulation.scenarios import scenario_named
from slammot_graph.simulation.worlds import world_named

LOGS = {"intel": 0.6, "aces": 0.6, "fr079": 0.6}
"""Recorded logs, and the share after which the first part ends."""

WORLDS = ("lab", "office", "hall")
RATE_HZ, MOVED, SECOND = 5.0, 0.2, 1000
FIRST_JUDGED_SEED = 3
"""What counts as changed was chosen on the seeds before."""

N_STARTS, N_STARTS_A_CELL = 50, 5
BUILDINGS = {"office": (1.0, 0.5), "hall": (1.0,), "building": (1.0, 0.5)}
"""Of the starts, and the shares of the first drive that are mapped: many start outside of a half."""

SEEN_M, IN_TIME_M, MOST_WAY_M, N_AFTER = 1.5, 5.0, 40.0, 150
"""Way within `SEEN_M` of the path of the first part counts, and a robot found after `IN_TIME_M` of it is so in time;
the search is given up after `MOST_WAY_M` of any way. So many scans are judged once it is found."""

WRONG_M = 1.0
ON_PIECE_M = 0.06
"""A point this near to a moved piece, in truth, is of it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Parts:
    """A log in two parts, or two logs of one building.

    Attributes
    ----------
    saved : SavedMap
        Of the first part.
    T_first : (n, 3) array
        Its trajectory, in the map.
    T_seen : (n, 3) array
        The same scans by the whole run, or in truth.
    scans : sequence of Scan
        Those of the second part.
    T_second : (k, 3) array
        Their poses in the frame of `T_seen`.
    """

    saved: SavedMap
    T_first: FloatArray
    T_seen: FloatArray
    scans: Sequence[Scan]
    T_second: FloatArray

    def expected(self, k: int) -> tuple[FloatArray, float]:
        """Pose (3,) of a scan of the second part in the map of the first, and how far from its path that is [m]."""
        away = np.hypot(*(self.T_seen[:, :2] - self.T_second[k, :2]).T)
        turned = np.abs(se2.wrap_angle(self.T_seen[:, 2] - self.T_second[k, 2]))
        near = int(np.argmin(away + turned))
        T_near_this = se2.between(self.T_seen[near], self.T_second[k])
        return se2.compose(self.T_first[near], T_near_this), float(away.min())


@cache
def recorded_parts(path: str, share: float) -> Parts:
    """A recorded log, cut."""
    scans = list(as_mounted(open_log(path)))
    n = int(share * len(scans))
    with Pipeline(PipelineConfig()) as whole:
        for scan in scans:
            whole.step(scan)
        T_whole = whole.final().T_map_base
    saved, T_first = _run_of(scans[:n])
    return Parts(
        saved=saved, T_first=T_first, T_seen=T_whole[:n], scans=_renumbered(scans[n:]), T_second=T_whole[n:]
    )


@cache
def simulated_parts(world: str, seed: int, share: float = 1.0) -> Parts:
    """Two drives through a simulated building, of which a share of the first is mapped."""
    scenario = replace(scenario_named(world), rate_hz=RATE_HZ)
    first, second = simulate(scenario, seed=seed), simulate(scenario, seed=seed + SECOND)
    n = int(share * first.n_scans)
    saved, T_first = _run_of(list(first)[:n])
    return Parts(
        saved=saved,
        T_first=T_first,
        T_seen=first.T_world_base[:n],
        scans=list(second),
        T_second=second.T_world_base,
    )


def _run_of(scans: Sequence[Scan]) -> tuple[SavedMap, FloatArray]:
    with Pipeline(PipelineConfig()) as pipeline:
        for scan in scans:
            pipeline.step(scan)
        final = pipeline.final()
    assert final.saved_map is not None
    return SavedMap.from_bytes(final.saved_map.to_bytes()), final.T_map_base


def _renumbered(scans: Sequence[Scan]) -> list[Scan]:
    return [replace(scan, index=k) for k, scan in enumerate(scans)]


def halves_cell(path: str, relations: str, share: float) -> Scores:
    """Errors over both parts of a recorded log: as one run, continued, and merged of two runs."""
    parts, truth = recorded_parts(path, share), read_relations(Path(relations))
    stamps = np.array([scan.stamp for scan in as_mounted(open_log(path))])

    def error(T_first: FloatArray, T_second: FloatArray) -> float:
        return float(evaluate_relations(stamps, np.vstack([T_first, T_second]), truth).translation_m.mean)

    with Pipeline(PipelineConfig(), MapStart(saved=parts.saved)) as pipeline:
        step_ms = [pipeline.step(scan).stage_ms["step"] for scan in parts.scans]
        continued = pipeline.final()
    saved, m = parts.saved, len(parts.saved.nodes)
    second, T_second = _run_of(parts.scans)
    merged = merge_maps([saved, second]).saved
    return {
        "whole": error(parts.T_seen, parts.T_second),
        "continued": error(
            moved_trajectory(parts.T_first, saved, continued.nodes[:m], "first"), continued.T_map_base
        ),
        "merged": error(
            moved_trajectory(parts.T_first, saved, merged.nodes[:m], "first"),
            moved_trajectory(T_second, second, merged.nodes[m:], "second"),
        ),
        "closures": len(closures_between_runs(merged)),
        "step_max_ms": float(np.max(step_ms[1:])),
        "bytes_per_keyframe": len(saved.to_bytes()) / len(saved.keyframe_nodes),
    }


def starts_cell(path: str | None, share: float, world: str, seed: int, first: int, n: int) -> Scores:
    """Start at random scans of the second part and localize without a guess."""
    parts = simulated_parts(world, seed, share) if path is None else recorded_parts(path, share)
    rng = np.random.default_rng(seed)
    n_last = len(parts.scans) - N_AFTER - 100
    starts = np.sort(rng.integers(0, n_last, N_STARTS))[first : first + n]
    return {"starts": [_start(parts, k) for k in starts.tolist()]}


def _start(parts: Parts, first: int) -> dict[str, float]:
    way_m = seen_m = 0.0
    errors: list[tuple[float, float]] = []
    found, n_after, step_ms = False, 0, [0.0]
    _, away_at_start_m = parts.expected(first)
    with Pipeline(PipelineConfig(), MapStart(saved=parts.saved, localize=True)) as pipeline:
        for k, scan in enumerate(_renumbered(parts.scans[first:])):
            step = pipeline.step(scan)
            step_ms.append(step.stage_ms["step"])
            T_expected, away_m = parts.expected(first + k)
            found = found or step.health != "lost"
            if found:
                n_after += 1
                if step.health != "lost":  # it may drive on beyond the map, and says so
                    offset = se2.between(T_expected, step.T_map_base)
                    errors.append((float(np.hypot(offset[0], offset[1])), abs(float(offset[2]))))
                if n_after > N_AFTER:
                    break
                continue
            moved_m = np.hypot(*(parts.T_second[first + k] - parts.T_second[max(first + k - 1, first)])[:2])
            way_m += moved_m
            seen_m += moved_m if away_m < SEEN_M else 0.0
            if way_m > MOST_WAY_M or seen_m > 3.0 * IN_TIME_M:
                break
    error_m, error_rad = np.array(errors or [(np.nan, np.nan)]).T
    return {
        "is_inside": float(away_at_start_m < SEEN_M),
        "is_found": float(found),
        "seen_m": seen_m,
        "way_m": way_m,
        "error_m": float(np.median(error_m)),
        "error_deg": float(np.degrees(np.median(error_rad))),
        "step_max_ms": float(np.max(step_ms[2:], initial=0.0)),
    }


def points_on(log: SimulatedLog, segments: FloatArray) -> BoolArray:
    """(n, beams) which points lie, in truth, on segments (k, 4) of the world, and are of nobody who walks."""
    found = np.zeros(log.ranges.shape, dtype=np.bool_)
    start, along = segments[:, :2], segments[:, 2:] - segments[:, :2]
    for k, scan in enumerate(log):
        off = scan.points(log.T_world_base[k])[:, None] - start
        share = np.clip((off * along).sum(axis=-1) / (along**2).sum(axis=-1), 0.0, 1.0)
        apart = off - share[..., None] * along
        found[k] = (np.hypot(apart[..., 0], apart[..., 1]) < ON_PIECE_M).any(axis=1)
    return found & ~log.is_moving


def changed_cell(world: str, seed: int, localize: bool) -> Scores:
    """A second drive with 20% of the furniture moved, against one with all of it in its place."""
    scenario = replace(scenario_named(world), rate_hz=RATE_HZ)
    parts, first = simulated_parts(world, seed), simulate(scenario, seed=seed)
    start = MapStart(saved=parts.saved, localize=localize)
    scores: Scores = {}
    for name, share in (("same", 0.0), ("moved", MOVED)):
        log = simulate(replace(scenario, moved=share, moved_seed=seed), seed=seed + SECOND)
        result = Run(log, start=start).complete()
        truth = se2.between(first.T_world_base[0], log.T_world_base)
        offset = se2.between(truth, result.T_map_base)[result.health != "lost"]
        scores[f"rmse_{name}"] = float(np.sqrt(np.mean(offset[:, 0] ** 2 + offset[:, 1] ** 2)))
        labelled = result.is_changed if result.is_changed is not None else np.zeros_like(result.is_valid)
        if not share:
            scores["labelled_same"] = int(labelled.sum())
            continue
        moved_world, is_moved = with_moved_furniture(world_named(scenario.world), share, seed)
        on_moved = points_on(log, moved_world.segments[is_moved]) & result.is_valid
        scores |= {
            "n_moved": int(on_moved.sum()),
            "n_labelled": int(labelled.sum()),
            "n_right": int((labelled & on_moved).sum()),
        }
    return scores


def experiment(options: Options) -> None:
    """Later runs in a saved map: continued, merged, started anywhere, and with the furniture moved."""
    tables = [table for table in (_halves(options), *_starts(options), _changed(options)) if table.rows]
    notes = [
        f"Recorded logs are cut after {100 * LOGS['intel']:.0f}%; of a simulated building there are two drives at"
        f" {RATE_HZ:g} scans a second. Starts: at random scans of the second part, localizing with no guess; way"
        f" counts within {SEEN_M:g} m of the first part's path, `inside` are starts there. Wrong: found more than"
        f" {WRONG_M:g} m off. Moved furniture: of all points of moved pieces, and of all points labelled as changed,"
        f" over the seeds from {FIRST_JUDGED_SEED} on; what counts as changed was chosen on those before.",
    ]
    write_tables("saved_maps", "Later runs in a saved map", notes, tables, options)


def _halves(options: Options) -> Table:
    cells = {}
    for name, share in {} if options.quick else LOGS.items():
        path, relations = options.recorded(f"{name}.clf.bz2"), options.recorded(f"{name}.relations")
        cells[name] = {"path": str(path), "relations": str(relations), "share": share}
    rows = [
        [
            name,
            *(f"{scores[key]:.4f}" for key in ("whole", "continued", "merged")),
            str(scores["closures"]),
            f"{scores['bytes_per_keyframe']:.0f}",
            f"{scores['step_max_ms']:.0f}",
        ]
        for name, scores in run_cells("saved_maps_halves", halves_cell, cells, options).items()
    ]
    columns = ("log", "one run [m]", "continued [m]", "merged [m]", "closures between the runs")
    return Table(
        heading="Relations over both parts",
        columns=(*columns, "bytes a keyframe", "longest step [ms]"),
        rows=rows,
    )


def _starts(options: Options) -> Iterator[Table]:
    logs = {} if options.quick else LOGS
    parts = list(logs.items())
    buildings = {"lab": (1.0,)} if options.quick else BUILDINGS
    parts += [(name, share) for name, shares in buildings.items() for share in shares]
    rows = []
    for name, share in parts:
        path = str(options.recorded(f"{name}.clf.bz2")) if name in logs else None
        label = name if name in logs or share == 1.0 else f"{name}, {100 * share:.0f}% mapped"
        n = options.seeds or (2 if options.quick else N_STARTS)
        cells = {
            f"{label} {first}": {
                "path": path,
                "share": share,
                "world": name,
                "seed": FIRST_JUDGED_SEED,
                "first": first,
                "n": min(N_STARTS_A_CELL, n - first),
            }
            for first in range(0, n, N_STARTS_A_CELL)
        }
        scores = run_cells("saved_maps_starts", starts_cell, cells, options)
        rows.append(_starts_row(label, [one for cell in scores.values() for one in cell["starts"]]))
    columns = ("log or world", "starts", "inside", "found in time", "found later", "wrong", "way [m]")
    yield Table(
        heading="Started anywhere, no guess",
        columns=(*columns, "error [m]", "[degrees]", "longest step [ms]"),
        rows=rows,
    )


def _starts_row(name: str, starts: list[dict[str, float]]) -> list[str]:
    inside = [one for one in starts if one["is_inside"]]
    found = [one for one in starts if one["is_found"]]
    in_time = [one for one in inside if one["is_found"] and one["seen_m"] <= IN_TIME_M]
    later = sum(one["is_found"] for one in inside) - len(in_time)

    def median(key: str, of: list[dict[str, float]]) -> float:
        return float(np.median([one[key] for one in of])) if of else np.nan

    return [
        name,
        str(len(starts)),
        str(len(inside)),
        str(len(in_time)),
        f"{later:.0f}",
        str(sum(one["error_m"] > WRONG_M for one in found)),
        number(median("seen_m", in_time), 1),
        number(median("error_m", found)),
        number(median("error_deg", found), 2),
        f"{max(one['step_max_ms'] for one in starts):.0f}",
    ]


def _changed(options: Options) -> Table:
    seeds = range(FIRST_JUDGED_SEED, FIRST_JUDGED_SEED + (options.seeds or (1 if options.quick else 3)))
    rows = []
    for world in WORLDS[:1] if options.quick else WORLDS:
        for localize in (False, True):
            what = "localized" if localize else "continued"
            cells = {
                f"{world} {what} {seed}": {"world": world, "seed": seed, "localize": localize}
                for seed in seeds
            }
            scores = list(run_cells("saved_maps_changed", changed_cell, cells, options).values())
            right, labelled, moved = (
                sum(one[key] for one in scores) for key in ("n_right", "n_labelled", "n_moved")
            )
            # a run whose place in the map was not found has no error there
            placed = [one for one in scores if math.isfinite(one["rmse_same"] + one["rmse_moved"])]
            rmse = [[one[f"rmse_{key}"] for one in placed] for key in ("same", "moved")]
            rows.append(
                [
                    f"{world}, {what}",
                    str(len(scores)),
                    str(len(placed)),
                    *(number(float(np.median(values)), 4) if values else "-" for values in rmse),
                    number(float(np.median(np.divide(rmse[1], rmse[0]))), 2) if placed else "-",
                    f"{right / max(labelled, 1):.3f}",
                    f"{right / max(moved, 1):.3f}",
                    str(sum(one["labelled_same"] for one in scores)),
                ]
            )
    columns = (
        "world",
        "seeds",
        "placed",
        "rmse, as before [m]",
        "with 20% moved [m]",
        "ratio",
        "precision",
        "recall",
    )
    return Table(heading="Furniture moved", columns=(*columns, "labelled where nothing moved"), rows=rows)


if __name__ == "__main__":
    sys.exit(main(experiment))
