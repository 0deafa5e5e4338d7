"""Points called moving beyond the labels of injected people: who or what they are."""

import sys

import numpy as np

from experiments import recorded
from experiments.common import Options, Scores, main, run_cells
from experiments.figures import draw_map, panels, save
from experiments.measures import run_method
from experiments.tables import Table, write_tables
from slammot_graph.core import se2
from slammot_graph.core.types import BoolArray, FloatArray, IntArray

LOGS = ("intel", "aces")
N_SCANS, QUICK_SCANS, N_PEOPLE = 2500, 200, 6
GAP_M = 0.4
"""Extra points nearer than this in one scan are one thing."""
SAME_PLACE_M, FAR_SCANS, MIN_VISITS = 0.3, 30, 3
"""What is called moving at one place in so many scans that far apart stands there: it is furniture."""
MIN_DISTANCE_M = 1.0
"""What got this far while it was tracked moves."""

SORTS = ("people of the log", "something else that moves", "furniture", "one place, once or twice")


def cell(log: str, reference: str, seed: int, n_scans: int) -> Scores:
    """Sort the extra moving points of one run: place, number of beams, sort of each thing."""
    walkers = recorded.with_walkers(log, reference, N_PEOPLE, seed, n_scans)
    result = run_method(walkers, "graph")
    of_log = recorded.is_of_the_log(walkers, reference)
    extra = result.is_moving & ~walkers.is_moving & result.is_valid
    T_map_start = se2.compose(walkers.T_world_base[0], se2.inverse(result.T_map_base[0]))
    scans, places, sizes, is_person = [], [], [], []
    for k, scan in enumerate(walkers):
        if not extra[k].any():
            continue
        points = scan.points(se2.compose(T_map_start, result.T_map_base[k]))[extra[k]]
        person = of_log[k][extra[k]]
        for members in _groups(points):
            scans.append(k)
            places.append(points[members].mean(axis=0))
            sizes.append(len(members))
            is_person.append(bool(person[members].mean() > 0.5))
    where = np.array(places).reshape(-1, 2)
    when = np.array(scans, dtype=np.int64)
    moves = _has_moved(where, when, result.tracks, T_map_start)
    stands = _comes_back(where, when)
    sort = np.select([np.array(is_person, dtype=np.bool_), moves, stands], [0, 1, 2], 3)
    right = int((result.is_moving & walkers.is_moving & result.is_valid).sum())
    return {"where": where.round(3).tolist(), "sizes": sizes, "sort": sort.tolist(), "right": right}


def _groups(points: FloatArray) -> list[IntArray]:
    """Points in beam order, split at gaps."""
    gaps = np.hypot(*np.diff(points, axis=0).T) > GAP_M
    return np.split(np.arange(len(points)), np.flatnonzero(gaps) + 1)


def _has_moved(where: FloatArray, when: IntArray, tracks: FloatArray, T_map_start: FloatArray) -> BoolArray:
    """(k,) things that belong to a track which got `MIN_DISTANCE_M` from where it began."""
    moves = np.zeros(len(where), dtype=np.bool_)
    for number in np.unique(tracks[:, 1]):
        track = tracks[tracks[:, 1] == number]
        if np.hypot(*(track[:, 2:4] - track[0, 2:4]).T).max() < MIN_DISTANCE_M:
            continue
        path = dict(zip(track[:, 9].astype(int), se2.transform(T_map_start, track[:, 2:4]), strict=True))
        for k in np.flatnonzero(np.isin(when, track[:, 9].astype(int))):
            moves[k] |= bool(np.hypot(*(where[k] - path[int(when[k])])) < SAME_PLACE_M)
    return moves


def _comes_back(where: FloatArray, when: IntArray) -> BoolArray:
    """(k,) things that are called moving at the same place at different times."""
    stands = np.zeros(len(where), dtype=np.bool_)
    for k in range(len(where)):
        near = np.sort(when[np.hypot(*(where - where[k]).T) < SAME_PLACE_M])
        n_visits = 1 + np.count_nonzero(np.diff(near) > FAR_SCANS)
        stands[k] = n_visits >= MIN_VISITS or (
            near[-1] - near[0] > 10 * FAR_SCANS and len(near) >= MIN_VISITS
        )
    return stands


def experiment(options: Options) -> None:
    """Sort the points called moving beyond the labels, on intel and aces with people injected."""
    n_scans = QUICK_SCANS if options.quick else N_SCANS
    seeds = options.seed_range(3, quick=1)
    cells, references = {}, {}
    for log in LOGS[:1] if options.quick else LOGS:
        path = str(options.recorded(f"{log}.clf.bz2"))
        references[log] = recorded.make_reference(log, options, n_scans)
        for seed in seeds:
            cells[f"{log} {seed} {n_scans}"] = {
                "log": path, "reference": references[log], "seed": seed, "n_scans": n_scans,
            }  # fmt: skip
    scores = run_cells("extra_moving_points", cell, cells, options)
    rows = []
    figure, (all_axes,) = panels(1, len(references), (7.0, 6.0))
    for axes, (log, reference) in zip(all_axes, references.items(), strict=True):
        found = [scores[key] for key in cells if key.startswith(log)]
        sizes = np.concatenate([np.array(score["sizes"], dtype=np.int64) for score in found])
        sort = np.concatenate([np.array(score["sort"], dtype=np.int64) for score in found])
        where = np.concatenate([np.array(score["where"]).reshape(-1, 2) for score in found])
        beams = np.bincount(sort, sizes, minlength=len(SORTS))
        right = sum(score["right"] for score in found)
        rows.append([log, str(right), *(f"{int(n)} ({n / (right + beams.sum()):.1%})" for n in beams)])
        grid = recorded.read_reference(reference).grid
        view = (*np.nanpercentile(where[:, 0], [0, 100]), *np.nanpercentile(where[:, 1], [0, 100]))
        draw_map(axes, grid, (view[0] - 3, view[1] + 3, view[2] - 3, view[3] + 3))
        for number, (name, color) in enumerate(
            zip(SORTS, ("#2f9e44", "#1c5fd4", "#d42a2a", "#c98a1b"), strict=True)
        ):
            axes.plot(*where[sort == number].T, ".", color=color, markersize=4, label=name)
        axes.set_title(log)
        axes.legend(loc="upper right", fontsize=8)
    save(figure, "extra_moving_points", options)
    notes = [
        f"The first {n_scans} scans of each log with {N_PEOPLE} people injected, {len(seeds)} seeds, final labels of"
        " `graph`: beams called moving that hit no injected person, and their share of all beams called moving."
        f" People of the log: within {recorded.NEAR_M:g} m of whoever moved {recorded.MIN_DISTANCE_M:g} m in the run"
        f" over the log as recorded. Something else that moves: its track got {MIN_DISTANCE_M:g} m away. Furniture:"
        f" called moving at one place (within {SAME_PLACE_M:g} m) at {MIN_VISITS} times, {FAR_SCANS} scans apart."
        " Figure: figures/extra_moving_points.png."
    ]
    columns = ["log", "on injected people", *SORTS]
    table = Table(heading="Beams called moving", columns=columns, rows=rows)
    write_tables("extra_moving_points", "Moving points beyond the labels", notes, [table], options)


if __name__ == "__main__":
    sys.exit(main(experiment))
