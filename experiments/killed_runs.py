"""Runs that end without warning: ``python -m experiments.killed_runs [--seeds N]``.

A run is killed (SIGKILL) at a random moment, with and without a recording, and again and again while it goes on; then
it goes on to its end. Told is how many folders could be read after each kill, and how many ended with the same
files, byte by byte, as the run that nobody killed. Checkpoints are made as often as half of the time allows, so that
many kills fall into the writing of one.
"""

import filecmp
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

from experiments.common import ROOT, Options, Scores, environment_of_checkout, main, run_cells
from experiments.tables import Table, write_tables
from slammot_graph.core.errors import InputError
from slammot_graph.run_folder.directory import RUN_FILES
from slammot_graph.run_folder.reader import read_run_folder

N_SCANS = 1500
N_KILLS = 4
SAME = sorted(set(RUN_FILES) - {"summary.json", "run.rrd", "overview.png"})
OF_TIME = ("stages_ms", "scans_per_s", "peak_memory_mb")

_PROGRAM = """
import sys
from slammot_graph import checkpoints
checkpoints.MOST_SHARE = 0.5
checkpoints.FIRST_AFTER_S = 0.0
from slammot_graph.cli import main
sys.exit(main(sys.argv[1:]))
"""


def experiment(options: Options) -> None:
    """Kill runs at random moments, and let them go on."""
    log = str(options.recorded("intel.clf.bz2"))
    seeds = options.seed_range(full=13, quick=1)
    cells = {
        f"{mode} {seed}": {"log": log, "mode": mode, "seed": seed}
        for mode in ("off", "file")
        for seed in seeds
    }
    scores = run_cells("killed_runs", killed, cells, options)
    rows = []
    for mode, name in (("off", "without a recording"), ("file", "with a recording")):
        of_mode = [scores[f"{mode} {seed}"] for seed in seeds]
        n_kills = sum(int(one["n_kills"]) for one in of_mode)
        n_read = sum(bool(one["recording_is_read"]) for one in of_mode)
        rows.append(
            [
                name,
                str(len(of_mode)),
                str(n_kills),
                str(sum(int(one["n_before_first"]) for one in of_mode)),
                f"{sum(int(one['n_readable']) for one in of_mode)} of {n_kills}",
                f"{sum(bool(one['is_same']) for one in of_mode)} of {len(of_mode)}",
                f"{n_read} of {len(of_mode)}" if mode == "file" else "-",
            ]
        )
    table = Table(
        heading="Killed, and gone on",
        columns=(
            "",
            "runs",
            "kills",
            "of these before the first scan was done",
            "folders readable after the kill",
            "same files in the end",
            "all parts of the recording readable",
        ),
        rows=rows,
    )
    notes = [
        f"The first {N_SCANS} scans of Intel, killed at random moments from the start of the program to its end; each"
        f" run {N_KILLS} times, as it goes on. Readable: `load_run` reads a partial run that says so, or, before the"
        " first scan was done, `--resume` begins. Same: "
        + ", ".join(SAME)
        + ", and summary.json but for times and memory."
    ]
    write_tables("killed_runs", "Runs that end without warning", notes, [table], options)


def killed(log: str, mode: str, seed: int) -> Scores:
    """Kill a run, let it go on, and compare with the run that nobody killed."""
    rng = np.random.default_rng([seed, mode == "file"])
    whole, took_s = _whole(log)
    took_s *= 1.3 if mode == "file" else 1.0
    n_readable = n_before = 0
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "out"
        words = [log, "--output", str(output), "--rerun", mode, "--max-scans", str(N_SCANS), "--resume"]
        for _ in range(N_KILLS):
            process = _start(words)
            time.sleep(float(rng.uniform(0.0, took_s)))
            process.send_signal(signal.SIGKILL)
            process.wait()
            state = _state(output)
            n_readable += state != "damaged"
            n_before += state == "nothing yet"
        is_over = _state(output) == "complete"
        done = _start(words)
        _, told = done.communicate()
        is_well = done.returncode == 0 or (is_over and "has ended" in told)
        return {
            "n_kills": N_KILLS,
            "n_readable": n_readable,
            "n_before_first": n_before,
            "is_same": is_well and _are_same(whole, output),
            "recording_is_read": mode == "file" and all(map(_is_read, output.glob("*.rrd"))),
            "told": told[-300:],
        }


def _start(words: list[str]) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-c", _PROGRAM, "run", *words],
        cwd=ROOT,
        env=environment_of_checkout(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def _whole(log: str) -> tuple[Path, float]:
    """Folder of the run that nobody killed, made once by each process, and how long it took [s]."""
    folder = Path(tempfile.gettempdir()) / f"killed_runs_{os.getpid()}_{N_SCANS}"
    clock = folder / "took_s"
    if not clock.exists():
        start = time.monotonic()
        words = [log, "--output", str(folder), "--rerun", "off", "--max-scans", str(N_SCANS), "--overwrite"]
        process = _start([*words, "--checkpoint-every", "0"])
        _, told = process.communicate()
        if process.returncode:
            raise InputError(told.strip().splitlines()[-1])
        clock.write_text(str(time.monotonic() - start))
    return folder, float(clock.read_text())


def _state(output: Path) -> str:
    """What `load_run` makes of a folder."""
    if not (output / "trajectory.tum").exists():
        return "nothing yet"
    try:
        run = read_run_folder(output)
    except InputError:
        return "damaged"
    if not run.summary:  # between the first trajectory and its summary
        return "partial"
    return "complete" if run.summary["is_complete"] else "partial"


def _are_same(one: Path, other: Path) -> bool:
    if not all(filecmp.cmp(one / name, other / name, shallow=False) for name in SAME):
        return False
    a, b = (json.loads((folder / "summary.json").read_text(encoding="utf-8")) for folder in (one, other))
    return all(a[key] == b.get(key) for key in a if key not in OF_TIME)


def _is_read(path: Path) -> bool:
    from rerun.chunk import RrdReader

    warnings.simplefilter("ignore")  # of parts that were cut off
    try:
        return sum(chunk.num_rows for chunk in RrdReader(path).stream()) > 0
    except Exception:  # whatever the reader says of a file that was cut off
        return path.stat().st_size == 0


if __name__ == "__main__":
    sys.exit(main(experiment))
