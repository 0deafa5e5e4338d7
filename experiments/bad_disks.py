"""Disks and folders that fail a run: ``python -m experiments.bad_disks``.

A run over a recorded log writes into a small file system of each of 20 sizes, into the folder of an earlier run that
may not be written or is of another user, into one that is removed on the way, and with a temporary folder that is full
or gone. Told is how it ends (exit code, last line), whether there was a traceback, what of the results is there and can
be read, and whether what was there before still is. File systems are mounted and users changed by root alone.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from experiments.common import ROOT, Options, Scores, environment_of_checkout, main, run_cells
from experiments.tables import Table, write_tables
from slammot_graph.core.errors import InputError
from slammot_graph.run_folder.reader import read_run_folder

SIZES_KB = (
    4,
    16,
    48,
    100,
    150,
    200,
    250,
    300,
    400,
    500,
    700,
    1000,
    1500,
    2000,
    3000,
    5000,
    8000,
    12000,
    20000,
    40000,
)
N_SCANS = 800
KEPT = "kept.txt"
OTHER_USER = 65534
PROGRAM = (sys.executable, "-m", "slammot_graph")
EARLIER_RUN = ("--max-scans", "20", "--rerun", "off")

AS_OTHER_USER = f"""
import os, sys
from slammot_graph.cli import main
log, earlier, *words = sys.argv[1:]
main(["run", log, "--output", earlier, *{EARLIER_RUN}])
os.setgroups([])
os.setegid({OTHER_USER})
os.seteuid({OTHER_USER})
sys.exit(main(words))
"""
"""Gives up its rights only once all is imported: the interpreter may lie where the other user may not read."""


def experiment(options: Options) -> None:
    """Run into disks that are full and folders that may not be written."""
    if os.geteuid() != 0:
        raise InputError(
            "only root may mount file systems and change users: run this as root, in a container"
        )
    log = str(options.recorded("intel.clf.bz2"))
    sizes = SIZES_KB[::7] if options.quick else SIZES_KB
    cells = {f"full {kb}": {"log": log, "fault": "full", "kb": kb} for kb in sizes}
    cells |= {name: {"log": log, "fault": name, "kb": 0} for name in FAULTS}
    scores = run_cells("bad_disks", suffer, cells, options)
    rows = [
        [
            f"disk of {one['kb']} kB full" if one["kb"] else key,
            str(one["code"]),
            "yes" if one["has_traceback"] else "no",
            str(one["n_poses"]),
            "yes" if one["keeps_what_was_there"] else "**no**",
            str(one["line"]),
        ]
        for key, one in scores.items()
    ]
    table = Table(
        heading="How it ends",
        columns=(
            "fault",
            "exit code",
            "traceback",
            "poses in the folder",
            "what was there stays",
            "last line",
        ),
        rows=rows,
    )
    notes = [
        f"{N_SCANS} scans of Intel with a recording and checkpoints. A disk that all fits into ends with exit code 0;"
        " where the recording or the checkpoints found no space but the results did, the exit code is 2 and all poses"
        " are there."
    ]
    write_tables("bad_disks", "Disks that are full, folders that may not be written", notes, [table], options)


def suffer(log: str, fault: str, kb: int) -> Scores:
    """Run into one of them."""
    with tempfile.TemporaryDirectory() as folder, _made(fault, Path(folder), kb, log) as place:
        output, environment, disturb = place
        disturber = None if disturb is None else threading.Thread(target=disturb)
        if disturber is not None:
            disturber.start()
        before = _kept(output)
        done = subprocess.run(
            _command(log, output, fault),
            cwd=ROOT,
            env={**environment_of_checkout(), **environment},
            capture_output=True,
            text=True,
            check=False,
        )
        if disturber is not None:
            disturber.join()
        lines = done.stderr.strip().splitlines()
        try:
            n_poses = len(read_run_folder(output).stamps)
        except InputError:
            n_poses = 0
        return {
            "kb": kb,
            "code": done.returncode,
            "has_traceback": "Traceback" in done.stderr,
            "n_poses": n_poses,
            "keeps_what_was_there": before.items() <= _kept(output).items(),
            "line": (lines[-1] if lines else "")
            .replace(folder, "")
            .replace(str(Path(log).parent), "")
            .replace("|", "/")[:160],
        }


Place = tuple[Path, dict[str, str], Callable[[], None] | None]


@contextmanager
def _made(fault: str, folder: Path, kb: int, log: str) -> Iterator[Place]:
    """Make what a fault needs: the output, variables of the environment, and who disturbs the run."""
    output = folder / "out"
    if fault == "full":
        with _small_disk(folder / "disk", kb) as disk:
            (disk / KEPT).write_text("kept")
            yield disk / "out", {}, None
    elif fault == "temporary folder full":
        with _small_disk(folder / "tmp", 4) as disk:
            (disk / "all").write_bytes(bytes(4096))
            yield output, {"TMPDIR": str(disk)}, None
    elif fault == "temporary folder gone":
        yield output, {"TMPDIR": str(folder / "none")}, None
    elif fault == "folder removed on the way":
        yield output, {}, lambda: _remove_when_there(output)
    else:
        folder.chmod(0o755)
        subprocess.run(
            [*PROGRAM, "run", log, "--output", str(output), *EARLIER_RUN],
            cwd=ROOT,
            capture_output=True,
            check=True,
        )
        if fault == "folder that may not be written":
            os.chown(output, OTHER_USER, OTHER_USER)
            output.chmod(0o555)
        yield output, {}, None


OF_OTHER_USERS = ("folder that may not be written", "folder of another user")
FAULTS = (
    "temporary folder full",
    "temporary folder gone",
    "folder removed on the way",
    *OF_OTHER_USERS,
)


@contextmanager
def _small_disk(path: Path, kb: int) -> Iterator[Path]:
    path.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={kb}k,mode=777", "tmpfs", str(path)], check=True)
    try:
        yield path
    finally:
        subprocess.run(["umount", str(path)], check=True)


def _remove_when_there(output: Path) -> None:
    deadline_s = time.monotonic() + 60.0
    while not (output / "trajectory.tum").exists() and time.monotonic() < deadline_s:
        time.sleep(0.05)
    shutil.rmtree(output, ignore_errors=True)


def _command(log: str, output: Path, fault: str) -> list[str]:
    words = ["run", log, "--output", str(output), "--max-scans", str(N_SCANS), "--checkpoint-every", "1"]
    if fault in OF_OTHER_USERS:
        earlier = str(output.with_name("earlier"))
        return [sys.executable, "-c", AS_OTHER_USER, log, earlier, *words, "--overwrite"]
    return [*PROGRAM, *words]


def _kept(output: Path) -> dict[str, bytes]:
    """What lies in the output and beside it before the run."""
    paths = [*output.glob("*"), output.parent / KEPT]
    return {path.name: path.read_bytes() for path in sorted(paths) if path.is_file()}


if __name__ == "__main__":
    sys.exit(main(experiment))
