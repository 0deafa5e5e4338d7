"""A robot that drives for a day: ``python -m experiments.long_drive [--hours H] [--world office]``.

Laps of a simulated building with people, 10 scans a second, without end; noise is new in each lap. Told are, for each
stretch of scans, the memory of the process, the mean time of a step and the error of the poses of the time, and for
each piece the error of the whole trajectory so far. The run is made in pieces: each goes on from the checkpoint of the
one before, in a process of its own, until it has run for ``--piece-minutes``; the same command goes on.
"""

import json
import os
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import tyro

from experiments.common import Options, say
from experiments.large_building import closed
from experiments.tables import Table, write_tables
from slammot_graph.core import se2
from slammot_graph.core.errors import SlammotError
from slammot_graph.core.scan import Scan, ScanTruth
from slammot_graph.core.types import FloatArray
from slammot_graph.evaluation import absolute_error
from slammot_graph.run import Run
from slammot_graph.run_folder.checkpoint import CheckpointFile
from slammot_graph.simulation import scenarios, simulate

N_SCANS_PER_HOUR = 36_000
N_STRETCH = 5_000
RANGE_STD_M, STEP_STD_M, STEP_STD_RAD = 0.005, 0.002, 0.001


@dataclass(frozen=True, kw_only=True)
class DriveOptions(Options):
    """Options of this experiment.

    Attributes
    ----------
    hours : float
        Of driving.
    world : str
    piece_minutes : float
        After so long the process ends; the same command goes on.
    """

    hours: float = 24.0
    world: str = "office"
    piece_minutes: float = 80.0

    @property
    def more_words(self) -> tuple[str, ...]:
        """Words of the command."""
        return ("--hours", f"{self.hours:g}", "--world", self.world)


class Laps:
    """The same lap again and again, with new noise of ranges and odometry each time; a source of scans.

    Attributes
    ----------
    truth : (n, 3) array
        True poses of a lap.
    """

    def __init__(self, world: str, n_scans: int) -> None:
        with patch.object(scenarios, "world_named", closed):
            log = simulate(world, seed=0, n_laps=2, laser="lms200")
        scans, poses = list(log), log.T_world_base
        first = len(poses) // 4
        later = np.arange(first + len(poses) // 3, len(poses))
        apart = se2.between(poses[first], poses[later])
        last = int(later[np.argmin(np.hypot(apart[:, 0], apart[:, 1]) + np.abs(apart[:, 2]))])
        self._scans: list[Scan] = scans[first:last]
        self.truth: FloatArray = poses[first:last]
        self.n_scans = n_scans

    def __iter__(self) -> Iterator[Scan]:
        n = len(self._scans)
        T_odom_base = np.zeros(3)
        rng = np.random.default_rng(0)
        for k in range(self.n_scans):
            if k % n == 0:
                rng = np.random.default_rng(k)
            scan, truth = self._scans[k % n], self.truth[k % n]
            if k:
                step = se2.between(self.truth[(k - 1) % n], truth)
                noise = rng.normal(size=3) * [STEP_STD_M, STEP_STD_M, STEP_STD_RAD]
                T_odom_base = se2.compose(T_odom_base, step * [1.01, 1.0, 1.01] + noise)
            yield Scan(
                index=k,
                stamp=0.1 * k,
                ranges=scan.ranges + rng.normal(0.0, RANGE_STD_M, len(scan.ranges)),
                laser=scan.laser,
                T_odom_base=T_odom_base,
                truth=ScanTruth(T_world_base=truth),
            )


def experiment(options: DriveOptions) -> None:
    """Drive on for one piece; write the table of what has been driven."""
    n_scans = round(options.hours * N_SCANS_PER_HOUR)
    if options.quick:
        n_scans = 2 * N_STRETCH
    folder = options.folder("results") / f"long_drive_{options.world}_{n_scans}"
    folder.mkdir(exist_ok=True)
    left: list[object] = []
    stretches = drive(Laps(options.world, n_scans), folder, 60.0 * options.piece_minutes, left)
    n_done = int(stretches[-1]["n_scans"]) if stretches else 0
    rows = [_row(one) for one in stretches[:: max(len(stretches) // 24, 1)]]
    if stretches and _row(stretches[-1]) not in rows:
        rows.append(_row(stretches[-1]))
    table = Table(
        heading=f"{options.world}, {n_done} of {n_scans} scans",
        columns=(
            "scans",
            "hours",
            "memory [MB]",
            "a scan [CPU ms]",
            "error of the poses [m]",
            "nodes",
            "not merged",
            "local maps",
        ),
        rows=rows,
    )
    notes = [
        "Laps of the simulated building with people, LMS200 at 10 Hz. memory: resident, of the whole process; time: of"
        " all that a scan takes, the simulator included; error: rmse of the poses when each scan came, over the"
        " stretch, after alignment with the truth.",
        "",
        *_scores(folder),
    ]
    write_tables("long_drive", "A robot that drives for a day", notes, [table], options)
    if left:  # its checkpoint is all that counts
        os._exit(0)


def drive(log: Laps, folder: Path, most_s: float, left: list[object]) -> list[dict[str, Any]]:
    """Go on with the run of a folder; gives what each stretch showed so far.

    A run that goes on later is put into `left`: let go of, it would label all of its scans first.
    """
    told, end = folder / "stretches.jsonl", folder / "end.json"
    stretches = [json.loads(line) for line in told.read_text().splitlines()] if told.exists() else []
    if end.exists():
        return stretches
    start_s = time.monotonic()
    file = CheckpointFile(folder)
    run = Run(log)
    frozen = file.read()
    if frozen is not None:
        run.resume(frozen)
        stretches = [one for one in stretches if one["n_scans"] <= frozen.n_scans]
        told.write_text("".join(json.dumps(one) + "\n" for one in stretches))
    poses, truth, cpu_s = list[FloatArray](), list[FloatArray](), time.process_time()
    steps = iter(run)
    for step in steps:
        assert step.scan.truth is not None
        assert step.scan.truth.T_world_base is not None
        poses.append(step.T_map_base)
        truth.append(step.scan.truth.T_world_base)
        if run.n_scans % N_STRETCH:
            continue
        localizer = run.pipeline.localizer  # type: ignore[union-attr]
        closer, graph = localizer.closer, localizer.graph  # type: ignore[union-attr]
        one = {
            "n_scans": run.n_scans,
            "memory_mb": memory_mb(),
            "step_ms": 1e3 * (time.process_time() - cpu_s) / len(poses),
            "error_m": absolute_error(np.array(poses), np.array(truth)).translation_m.rmse,
            "n_nodes": len(graph),
            "n_solved": len(graph) - graph.n_merged,
            "n_submaps": len(closer.submaps),
        }
        stretches.append(one)
        with told.open("a") as lines:
            lines.write(json.dumps(one) + "\n")
        say(f"long_drive: {one}")
        poses, truth, cpu_s = [], [], time.process_time()
        if time.monotonic() - start_s > most_s:
            file.write(run.freeze())
            _keep_scores(run, folder / "so_far.json")
            say("long_drive: the time of this piece is over; the same command goes on")
            left.append(steps)
            return stretches
    _keep_scores(run, end)
    return stretches


def _keep_scores(run: Run, path: Path) -> None:
    """Write how well the whole trajectory is known, optimised by all scans so far."""
    result = run.trajectory()
    assert result.T_world_base is not None
    scores = {
        "n_scans": len(result.stamps),
        "rmse_m": absolute_error(result.T_map_base, result.T_world_base).translation_m.rmse,
        "n_closures": sum(edge.kind == "closure" for edge in result.edges),
    }
    path.write_text(json.dumps(scores))


def memory_mb(name: str = "VmRSS") -> float:
    """Resident memory of this process [MB]."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) / 1024.0 for line in lines if line.startswith(name))


def _row(one: dict[str, Any]) -> list[str]:
    n = int(one["n_scans"])
    return [
        str(n),
        f"{n / N_SCANS_PER_HOUR:.2f}",
        f"{one['memory_mb']:.0f}",
        f"{one['step_ms']:.2f}",
        f"{one['error_m']:.3f}",
        str(one["n_nodes"]),
        str(one["n_solved"]),
        str(one["n_submaps"]),
    ]


def _scores(folder: Path) -> list[str]:
    path = next((folder / name for name in ("end.json", "so_far.json") if (folder / name).exists()), None)
    if path is None:
        return ["The first piece has not ended yet."]
    one = json.loads(path.read_text())
    has_ended = "" if path.name == "end.json" else " The run has not ended; the same command goes on."
    return [
        f"After {one['n_scans']} scans: rmse of the whole trajectory, optimised, {one['rmse_m']:.3f} m;"
        f" {one['n_closures']} closures.{has_ended}"
    ]


def main() -> int:
    """Run the experiment from the command line."""
    options = tyro.cli(DriveOptions, description=__doc__, config=(tyro.conf.FlagCreatePairsOff,))
    try:
        with suppress(KeyboardInterrupt):
            experiment(options)
    except SlammotError as error:
        say(str(error))
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
