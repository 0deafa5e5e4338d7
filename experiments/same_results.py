"""Whether two revisions give the same results, byte by byte: for a change that must not change any.

``python -m experiments.same_results run --output DIR [--code CHECKOUT]`` runs every method over recorded and simulated
logs with the code of a checkout (this one if left out);
``python -m experiments.same_results compare DIR_BEFORE DIR_AFTER`` compares what the runs hand out and prints the
files that differ. kiss-icp sums in the order in which its threads finish: two runs of one revision differ in the last
digits, so its files count as equal when all poses agree to 1e-6 m, and its covariances to 1e-6 of the largest.
"""

import filecmp
import os
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from experiments.common import ROOT
from slammot_graph.methods import METHODS

FILES = ("trajectory.tum", "points.npz", "tracks.csv", "map.pgm", "graph.g2o", "covariances.npz")
"""What a run hands out; the other files hold times, versions and settings."""

N_INTEL = 3000

SAME_M = 1e-6
"""Poses nearer than this are the same where a method is not reproducible."""


def _logs(folder: Path) -> dict[str, list[str]]:
    """Arguments of `slammot-graph run` for each log."""
    named = os.environ.get("SLAMMOT_DATA")
    data = Path(named) if named else ROOT.parent / "shared" / "data"
    return {
        "two-walkers": [str(folder / "two-walkers.npz")],
        "intel": [str(data / "freiburg/intel.clf.bz2"), "--max-scans", str(N_INTEL)],
        "wheelchair": [str(data / "bags/general_tracking_moving_1.bag")],
        "clinic": [str(data / "freiburg/fr-clinic_robotlaser.clf.bz2")],
    }


def run(
    output: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    code: Path = ROOT,
    methods: tuple[str, ...] = tuple(METHODS),
) -> int:
    """Run every method over every log."""
    environment = {**os.environ, "PYTHONPATH": str(code.resolve())}
    output = output.resolve()
    output.mkdir(parents=True, exist_ok=True)
    program = [sys.executable, "-m", "slammot_graph"]

    def call(*words: str) -> None:
        subprocess.run([*program, *words], check=True, cwd=code, env=environment, stdout=subprocess.DEVNULL)

    call("simulate", "two-walkers", "--seed", "0", "--output", str(output / "two-walkers.npz"))
    for log, words in _logs(output).items():
        for method in methods:
            folder = output / log / method
            call(
                *("run", *words, "--method", method, "--output", str(folder), "--rerun", "off", "--overwrite")
            )
            print(f"{log} {method}", flush=True)
    return 0


def compare(before: tyro.conf.Positional[Path], after: tyro.conf.Positional[Path]) -> int:
    """Compare two outputs of `run`; the exit code is 1 where they differ."""
    n_equal, differing = 0, []
    for path, other in _pairs(before, after):
        if _is_equal(path, other):
            n_equal += 1
        else:
            differing.append(str(path.relative_to(before)))
    for name in differing:
        print(f"differs: {name}")
    print(f"{n_equal} files are equal, {len(differing)} differ")
    return int(bool(differing) or n_equal == 0)


def _pairs(before: Path, after: Path) -> Iterator[tuple[Path, Path]]:
    for log in _logs(before):
        for folder in sorted((before / log).iterdir()):
            for name in FILES:
                if (folder / name).exists() or (after / log / folder.name / name).exists():
                    yield folder / name, after / log / folder.name / name


def _is_equal(path: Path, other: Path) -> bool:
    """Tell whether two files are equal; of an .npz, its members (an archive also holds the time of writing)."""
    if not path.exists() or not other.exists():
        return False
    if "kiss-icp" in path.parent.name:
        return _is_close(path, other)
    if path.suffix != ".npz":
        return filecmp.cmp(path, other, shallow=False)
    with zipfile.ZipFile(path) as a, zipfile.ZipFile(other) as b:
        return a.namelist() == b.namelist() and all(a.read(name) == b.read(name) for name in a.namelist())


def _is_close(path: Path, other: Path) -> bool:
    """Tell whether two files of a baseline that is not reproducible agree."""
    if path.suffix == ".tum":
        a, b = np.loadtxt(path), np.loadtxt(other)
        return a.shape == b.shape and bool(np.abs(a - b).max() < SAME_M)
    if path.name == "covariances.npz":
        a, b = np.load(path)["cov_map"], np.load(other)["cov_map"]
        return a.shape == b.shape and bool(np.abs(a - b).max() < SAME_M * np.abs(a).max())
    if path.suffix == ".npz":
        with zipfile.ZipFile(path) as first, zipfile.ZipFile(other) as second:
            return all(first.read(name) == second.read(name) for name in first.namelist())
    pixels, others = (np.frombuffer(file.read_bytes(), dtype=np.uint8) for file in (path, other))
    return pixels.shape == others.shape and bool(np.mean(pixels != others) < 1e-3)


def main() -> int:
    """Run or compare."""
    code: int = tyro.extras.subcommand_cli_from_dict({"run": run, "compare": compare}, description=__doc__)
    return code


if __name__ == "__main__":
    sys.exit(main())
