"""Every method on every scenario as one study: ``python -m experiments.ablation``.

It is the package's own study `ablation`. All its processes are killed in the middle, and the same command goes on. Some
of its seeds are computed again by a Dask scheduler with two workers, one seed by one worker and by two in turn, which
tells how much faster two are (where the machine does nothing else): all must give the same results, bit by bit.
"""

import csv
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

from experiments.common import Options, Scores, environment_of_checkout, main, run_cells, say
from experiments.study_overhead import N_WORKERS, cluster
from experiments.tables import Table, number, write_tables
from slammot_graph.core.errors import InputError
from slammot_graph.study.plan import plan
from slammot_graph.study.report import NOTE, tables
from slammot_graph.study.results import read_results, write_results
from slammot_graph.study.store import CellStore
from slammot_graph.study.study_file import read_study, study_path

N_SEEDS, DASK_SEEDS, QUICK_SEEDS = 20, 5, 1
QUICK_RATE_HZ = 5.0
TURNS = (1, N_WORKERS, N_WORKERS, 1)
"""Workers of the runs that are timed, one after the other: what drifts hits both alike."""


@dataclass(frozen=True, kw_only=True)
class Part:
    """The study, or some seeds of it, computed once.

    Attributes
    ----------
    name : str
    way : str
        "killed" in the middle and gone on, by "dask", or by so many workers.
    n_seeds : int
    study, folder : Path
        The study's file, and where its results go.
    """

    name: str
    way: str
    n_seeds: int
    study: Path
    folder: Path


def experiment(options: Options) -> None:
    """Every method on every scenario as one study: killed and gone on, by Dask, by one worker and by two."""
    for package in ("distributed", *(() if options.quick else ("jupedsim",))):
        if find_spec(package) is None:  # better now than after the first half an hour
            raise InputError(f"ablation: no package {package}; pip install -e '.[dev]'")
    folder = options.folder("results") / "ablation"
    if options.fresh:
        shutil.rmtree(folder, ignore_errors=True)
    n_seeds = len(options.seed_range(N_SEEDS, QUICK_SEEDS))
    ways = [
        ("killed and gone on, two workers", "killed", n_seeds),
        ("Dask, two workers", "dask", min(DASK_SEEDS, n_seeds)),
        *((f"turn {k}, {n} worker{'s' * (n > 1)}", f"{n}", 1) for k, n in enumerate(TURNS, start=1)),
    ]
    parts = [
        Part(name=name, way=way, n_seeds=n, study=_study(folder, n, options), folder=folder / name)
        for name, way, n in (ways[:4] if options.quick else ways)
    ]
    scores: dict[str, Scores] = {}
    for part in parts:  # one after the other: what is timed has the machine for itself
        cell = {"study": str(part.study), "output": str(part.folder), "way": part.way}
        scores |= run_cells("ablation", computed, {part.name: cell}, options)
    notes = [
        f"All methods on all scenarios (corridor and building with 5 scans a second, the others with 10), {n_seeds}"
        f" paired seeds. {NOTE} ATE after planar alignment, root mean square. The map is compared with that of the"
        " same drive without people at true poses.",
        "",
        "The study itself: `slammot-graph study`, killed (SIGKILL, with all its processes) with"
        f" {scores[parts[0].name]['n_kept']} cells, gone on with by the same command; then some of its seeds"
        " anew. Wall time of the whole command, with the start of its processes; time of the cells by their own clocks."
        " Same: `results.csv` and `results.parquet` are, byte by byte, those that the cells of the study that was"
        " killed give for these seeds.",
    ]
    made = [_of_study(parts, scores), *tables(read_results(parts[0].folder))]
    write_tables("ablation", "Ablation: all methods on all scenarios", notes, made, options)


def computed(study: str, output: str, way: str) -> Scores:
    """Compute a study in one of the ways of `Part`: how long it took [s], and with how many cells it was killed."""
    folder, words = Path(output), ["study", study, "--output", output]
    if way == "killed":
        words += ["--jobs", f"{N_WORKERS}"]
        n_kept = _kill_in_the_middle(words, Path(study), folder)
        _finish(words)
        return {"n_kept": n_kept}
    shutil.rmtree(folder, ignore_errors=True)
    with cluster() if way == "dask" else nullcontext(("", 0)) as (address, _):
        start = time.perf_counter()
        _finish([*words, *(["--scheduler", address] if address else ["--jobs", way])])
        return {"seconds": time.perf_counter() - start}


def _study(folder: Path, n_seeds: int, options: Options) -> Path:
    """Write the package's study with other seeds, in quick mode with few scans of its first scenario; its path."""
    text = study_path(Path("ablation")).read_text(encoding="utf-8")
    text, n_found = re.subn(r"(?m)^seeds = 20$", f"seeds = {n_seeds}", text)
    assert n_found == 1
    if options.quick:
        text = "[[scenario]]".join(text.split("[[scenario]]")[:2]).rstrip() + f"\nrate_hz = {QUICK_RATE_HZ}\n"
    path = folder / f"ablation {n_seeds}.toml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def _start(words: list[str]) -> "subprocess.Popen[bytes]":
    """Start slammot-graph of this checkout in a process group of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "slammot_graph", *words],
        env=environment_of_checkout(),
        stdout=subprocess.DEVNULL,
        start_new_session=True,
    )


def _finish(words: list[str]) -> None:
    process = _start(words)
    try:
        code = process.wait()
    except BaseException:  # Ctrl-C does not reach another group by itself
        os.killpg(process.pid, signal.SIGINT)
        process.wait()
        raise
    if code:
        raise InputError(f"slammot-graph {' '.join(words)}: exit code {code}; what it said is above")


def _kill_in_the_middle(words: list[str], study: Path, folder: Path) -> int:
    """Kill a study and all its processes once half of what is missing is there; gives how many cells it had then."""
    digests = {row.cell.digest for row in plan(read_study(study), study.parent)}

    def n_done() -> int:
        return len(digests & CellStore(folder / "cells").records().keys())

    enough = (len(digests) + n_done()) // 2
    process = _start(words)
    try:
        while process.poll() is None and n_done() < enough:
            time.sleep(0.2)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    n_kept = n_done()
    say(f"ablation: killed with {n_kept} of {len(digests)} cells")
    return n_kept


def _of_study(parts: Sequence[Part], scores: Mapping[str, Scores]) -> Table:
    """What became of the study each time, and whether its results are the same."""
    rows = []
    seconds: dict[str, list[float]] = {}
    for part in parts:
        wall = scores[part.name].get("seconds", math.nan)
        seconds.setdefault(part.way, []).append(wall)
        with (part.folder / "times.csv").open(encoding="utf-8", newline="") as file:
            times = [float(row["seconds"]) for row in csv.DictReader(file)]
        same = "-" if part is parts[0] else "yes" if is_same(part, parts[0].folder) else "NO"
        rows.append(
            [part.name, f"{part.n_seeds}", f"{len(times)}", number(wall, 1), number(sum(times), 1), same]
        )
    gain = sum(seconds["1"]) / sum(seconds[f"{N_WORKERS}"])
    return Table(
        heading=f"The study itself: two workers are {gain:.2f} times as fast as one",
        columns=["", "seeds", "cells", "wall time [s]", "sum of the cells [s]", "same results"],
        rows=rows,
    )


def is_same(part: Part, whole: Path) -> bool:
    """Whether results are those of the finished cells of another folder, byte by byte."""
    rows = plan(read_study(part.study), part.study.parent)
    with TemporaryDirectory() as temporary:
        write_results(Path(temporary), rows, CellStore(whole / "cells").records(), {}, {})
        return all(
            (Path(temporary) / name).read_bytes() == (part.folder / name).read_bytes()
            for name in ("results.csv", "results.parquet")
        )


if __name__ == "__main__":
    sys.exit(main(experiment))
