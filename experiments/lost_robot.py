"""Odometry that jumps once, and a robot that is kidnapped with its laser occluded."""

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

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
    write_report,
)
from experiments.tables import Table
from slammot_graph import open_log
from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import FloatArray
from slammot_graph.evaluation import absolute_error, evaluate_relations, read_relations
from slammot_graph.logs import LaserLog, SkippedScan
from slammot_graph.simulation import SimulatedLog, simulate

JUMP_M = 2.0
KIDNAPPED_M = 5.0
N_OCCLUDED = 20
QUICK_SCANS = 600
OCCLUSIONS = {"no return": np.inf, "0.05 m": 0.05}
"""What an occluded laser says [m]; infinite stands for its maximum."""

JUMP_COLUMNS = (
    "log",
    "jump",
    "scans out of in",
    "failed matches",
    "lost",
    "translation error [m]",
    "without the jump",
    "largest [m]",
    "at the end [m]",
    "closures",
)
KIDNAPPED_COLUMNS = (
    "log",
    "occluded laser says",
    "kidnapped at scan",
    "scans out of in",
    "lost at scan",
    "first closure old-new after",
    "closures old-new",
    "wrong ones",
    "error before, ATE rmse [m]",
    "error after [m]",
    "at the end [m]",
    "[degrees]",
    "at the end without closures [m]",
)


class JumpedLog:
    """A log whose odometry jumps once.

    Parameters
    ----------
    log : LaserLog
    at : int
        The first scan after the jump.
    T_odom_jump : (3,) array
        What lies before the odometry from there on.
    """

    def __init__(self, log: LaserLog, at: int, T_odom_jump: FloatArray) -> None:
        self.path = Path(f"{log.path} with a jump")
        self.n_scans = log.n_scans
        self.skipped: list[SkippedScan] = log.skipped
        self.warnings: list[str] = log.warnings
        self._log = log
        self._at = at
        self._T_odom_jump = T_odom_jump

    def __iter__(self) -> Iterator[Scan]:
        for scan in self._log:
            if scan.index < self._at:
                yield scan
            else:
                assert scan.T_odom_base is not None
                jumped = se2.compose(self._T_odom_jump, scan.T_odom_base)
                yield replace(scan, T_odom_base=jumped, odometry=None)
        self.skipped, self.warnings = self._log.skipped, self._log.warnings


@dataclass(frozen=True, kw_only=True, eq=False)
class Kidnapped:
    """A log of a robot that was kidnapped.

    Attributes
    ----------
    log : SimulatedLog
    first_occluded, first_after : int
        Scans: the laser is occluded from the one until the other.
    """

    log: SimulatedLog
    first_occluded: int
    first_after: int


def kidnap(log: SimulatedLog, at: int, occluded_m: float) -> Kidnapped:
    """Cut out the stretch after scan `at` in which the robot gets `KIDNAPPED_M` away, with the laser occluded.

    The wheels do not turn: odometry goes on where it was. Odometry turns of the stretch left out are left out too.
    """
    away_m = np.hypot(*(log.T_world_base[at:, :2] - log.T_world_base[at, :2]).T)
    beyond = np.flatnonzero(away_m >= KIDNAPPED_M)
    if not len(beyond):
        raise InputError(f"{log.path}: the robot does not get {KIDNAPPED_M} m away after scan {at}")
    after = at + int(beyond[0])
    standing = np.full(N_OCCLUDED, at)
    kept = np.concatenate([np.arange(at + 1), standing, np.arange(after, log.n_scans)])
    T_odom_base = log.T_odom_base[kept].copy()
    n_before = at + 1 + N_OCCLUDED
    T_shift = se2.compose(log.T_odom_base[at], se2.inverse(log.T_odom_base[after]))
    T_odom_base[n_before:] = se2.compose(T_shift[None, :], T_odom_base[n_before:])
    ranges = log.ranges[kept].copy()
    ranges[at + 1 : n_before] = log.laser.range_max if np.isinf(occluded_m) else occluded_m
    is_moving, object_id = log.is_moving[kept].copy(), log.object_id[kept].copy()
    is_moving[at + 1 : n_before], object_id[at + 1 : n_before] = False, -1
    kidnapped = SimulatedLog(
        name=f"{log.path} kidnapped",
        laser=log.laser,
        stamps=log.stamps[0] + np.median(np.diff(log.stamps)) * np.arange(len(kept)),
        ranges=ranges,
        T_odom_base=T_odom_base,
        T_world_base=log.T_world_base[kept],
        is_moving=is_moving,
        object_id=object_id,
        objects=log.objects[kept],
    )
    return Kidnapped(log=kidnapped, first_occluded=at + 1, first_after=n_before)


def experiment(options: LoopOptions) -> None:
    """Odometry that jumps by 2 m once; a robot kidnapped by 5 m with its laser occluded."""
    tables = [
        Table(heading="Odometry jumps by 2 m once", columns=JUMP_COLUMNS, rows=_jumps(options)),
        Table(
            heading="Kidnapped, 5 m away, with the laser occluded",
            columns=KIDNAPPED_COLUMNS,
            rows=_kidnapped(options.quick),
        ),
    ]
    intro = (
        f"Jump: from some scan on the odometry lies {JUMP_M:g} m aside. Errors: mean over the relations of a recorded"
        " log, ATE rmse of a simulated one after planar alignment. Kidnapped: a stretch of the log in which the robot"
        f" gets {KIDNAPPED_M:g} m away is cut out; in its place are {N_OCCLUDED} scans with an occluded laser and"
        " standing odometry. old-new: closures between nodes before and after; wrong: more than 0.5 m or"
        " 5 degrees from the truth. `at the end`: error of the last pose with the"
        " first ones laid onto each other; `error after`: rmse of the poses after, laid onto the truth by those before."
    )
    write_report("lost_robot", options, "A lost robot", [intro], tables)


def _jumps(options: LoopOptions) -> list[list[str]]:
    T_jump = np.array([JUMP_M * np.sqrt(0.5), JUMP_M * np.sqrt(0.5), 0.0])
    office = simulate("lab" if options.quick else "office", seed=0)
    shares = (0.5,) if options.quick else (0.3, 0.6)
    plain = run_watched(office)
    rows = [_jump_row(office, share, T_jump, None, _ate(office), plain) for share in shares]
    try:
        found = logs_with_relations(options)
    except InputError as error:
        say(f"lost_robot: no recorded logs: {error}")
        return rows
    for name, (path, relations_path) in found.items():
        if name != "intel" and not options.quick:
            continue
        relations = read_relations(relations_path)
        log = open_log(path)

        def score(run: WatchedRun, relations=relations) -> tuple[float, float, float]:  # type: ignore[no-untyped-def]
            scores = evaluate_relations(run.result.stamps, run.result.T_map_base, relations).translation_m
            return scores.mean, scores.max, np.nan

        max_scans = QUICK_SCANS if options.quick else None
        plain = run_watched(log, max_scans=max_scans)
        rows += [_jump_row(log, share, T_jump, max_scans, score, plain) for share in shares]
    return rows


Score = Callable[[WatchedRun], tuple[float, float, float]]


def _ate(log: SimulatedLog) -> Score:
    def score(run: WatchedRun) -> tuple[float, float, float]:
        truth = log.T_world_base[: len(run.result.stamps)]
        error = absolute_error(run.result.T_map_base, truth).translation_m
        return error.rmse, error.max, _end_error(run, truth)[0]

    return score


def _jump_row(
    log: LaserLog, share: float, T_jump: FloatArray, max_scans: int | None, score: Score, plain: WatchedRun
) -> list[str]:
    n_scans = log.n_scans if max_scans is None else min(max_scans, log.n_scans)
    at = int(share * n_scans)
    name = log.path.name.split(".")[0]
    try:
        run = run_watched(JumpedLog(log, at, T_jump), max_scans=max_scans)
    except Exception as err:  # that nothing crashes is what is tested
        return [name, f"at scan {at}", f"**failed: {err}**", *["-"] * 7]
    error, largest, end = score(run)
    row = [
        name,
        f"at scan {at}",
        f"{len(run.result.stamps)} of {n_scans - run.result.n_skipped}",
        f"{run.result.n_failed_matches} ({plain.result.n_failed_matches})",
        f"{count_events(run.result, 'lost')} ({count_events(plain.result, 'lost')})",
        f"{error:.4f}",
        f"{score(plain)[0]:.4f}",
        f"{largest:.3f}",
        "-" if np.isnan(end) else f"{end:.3f}",
        f"{len(closures_of(run.result))} ({len(closures_of(plain.result))})",
    ]
    say(f"lost_robot: {' | '.join(row)}")
    _tell(run, at)
    return row


def _kidnapped(quick: bool) -> list[list[str]]:
    rows = []
    cells = (("office", 1, 0, 0.2),) if quick else KIDNAPPED_CELLS
    for world, n_laps, seed, share in cells:
        whole = simulate(world, seed=seed, n_laps=n_laps, rate_hz=5.0 if quick else None)
        for occlusion, occluded_m in list(OCCLUSIONS.items())[: 1 if quick or seed else None]:
            kidnapped = kidnap(whole, int(share * whole.n_scans), occluded_m)
            rows.append(_kidnapped_row(f"{world}, {n_laps} laps, seed {seed}", occlusion, kidnapped))
    return rows


KIDNAPPED_CELLS = (
    ("office", 2, 0, 0.35),
    ("office", 2, 1, 0.5),
    ("hall", 2, 0, 0.3),
    ("building", 1, 0, 0.3),
    ("building", 1, 1, 0.5),
)
"""World, laps, seed, and where in the log the robot is picked up."""


def _kidnapped_row(name: str, occlusion: str, kidnapped: Kidnapped) -> list[str]:
    log = kidnapped.log
    try:
        run, alone = run_watched(log), run_watched(log, "graph-noloop")
    except Exception as error:  # that nothing crashes is what is tested
        return [name, occlusion, str(kidnapped.first_occluded), f"**failed: {error}**", *["-"] * 9]
    result = run.result
    node_scans = result.node_scans
    joining = [
        edge
        for edge in closures_of(result)
        if min(node_scans[[edge.from_node, edge.to_node]]) < kidnapped.first_occluded
        and max(node_scans[[edge.from_node, edge.to_node]]) >= kidnapped.first_after
    ]
    lost = [event.scan for event in result.events if event.kind == "lost"]
    n = kidnapped.first_occluded
    before = absolute_error(result.T_map_base[:n], log.T_world_base[:n])
    laid = se2.compose(before.T_world_map[None, :], result.T_map_base)
    off_m = np.hypot(*(laid - log.T_world_base)[kidnapped.first_after :, :2].T)
    end_m, end_deg = _end_error(run, log.T_world_base)
    first = min((node_scans[edge.to_node] for edge in joining), default=-1)
    row = [
        name,
        occlusion,
        str(kidnapped.first_occluded),
        f"{len(result.stamps)} of {log.n_scans}",
        ", ".join(map(str, lost[:3])) + (f" and {len(lost) - 3} more" if len(lost) > 3 else "")
        or "**never**",
        f"{first - kidnapped.first_after} scans" if joining else "**none**",
        str(len(joining)),
        str(int(is_wrong(*closure_errors(joining, log.T_world_base[node_scans])).sum())),
        f"{before.translation_m.rmse:.3f}",
        f"{np.sqrt(np.mean(off_m**2)):.3f}",
        f"{end_m:.3f}",
        f"{end_deg:.2f}",
        f"{_end_error(alone, log.T_world_base)[0]:.3f}",
    ]
    say(f"lost_robot: {' | '.join(row)}")
    _tell(run, kidnapped.first_occluded)
    return row


def _end_error(run: WatchedRun, truth: FloatArray) -> tuple[float, float]:
    T = run.result.T_map_base
    off = se2.between(truth[-1], se2.compose(se2.compose(truth[0], se2.inverse(T[0])), T[-1]))
    return float(np.hypot(off[0], off[1])), float(np.degrees(abs(off[2])))


def _tell(run: WatchedRun, at: int) -> None:
    """The events just after something happened."""
    events = [event for event in run.result.events if at <= event.scan < at + 60]
    for event in events[:6]:
        say(f"lost_robot:   scan {event.scan}: {event.text}")


if __name__ == "__main__":
    sys.exit(command_line(experiment, LoopOptions, None))
