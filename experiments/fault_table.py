"""What happens when something goes wrong, and which test holds it: ``python -m experiments.fault_table``.

Runs the tests that each row names and prints fault, what happens, how it is tested, and the result. ``--list`` prints
the table without running anything; ``--page`` writes it to ``docs/faults.md``, with the figures of the experiments that
take longer than a test may.
"""

import argparse
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True, kw_only=True)
class Row:
    """A kind of fault.

    Attributes
    ----------
    fault, outcome : str
        What goes wrong, and what happens then.
    test : str
        The tests that hold it, as pytest names them.
    """

    fault: str
    outcome: str
    test: str


ROWS = (
    Row(
        fault="damaged logs, run folders, settings (fuzzed)",
        outcome="what is usable, or one line, exit 2",
        test="tests/fuzz/test_readers.py",
    ),
    Row(
        fault="pipes, devices, bombs, bags 1.2, odd settings",
        outcome="one line with the remedy, exit 2",
        test="tests/logs/test_cases.py -k told or damaged or settings",
    ),
    Row(
        fault="a file of the results cannot be written",
        outcome="all others are, one line, exit 2",
        test="tests/run_folder/test_writer.py -k keeps_no_other",
    ),
    Row(
        fault="disk full, quota, no memory for the map",
        outcome="trajectory, summary and labels first; the recording gives way; exit 2",
        test="tests/cli/test_full_disk.py",
    ),
    Row(
        fault="the recording cannot go on",
        outcome="it ends, the run does not; same results, exit 2",
        test="tests/viz/rerun/test_run.py -k full_disk or told_once",
    ),
    Row(
        fault="TMPDIR full or gone",
        outcome="scans stay in memory, the run goes on",
        test="tests/core/test_spool.py tests/detection/test_scan_history.py -k read_back or no_scan_is_lost",
    ),
    Row(
        fault="labels, tracks, trajectory or map fail at the end",
        outcome="all else is written, one line, exit 2",
        test="tests/test_run.py -k failing_end or too_large",
    ),
    Row(
        fault="two runs into one folder; kill -9",
        outcome="the second is refused; a dead owner's lock is taken over",
        test="tests/run_folder/test_lock.py",
    ),
    Row(
        fault="kill -9, a power cut",
        outcome="a partial run that can be read; `--resume` goes on, the same files in the end",
        test="tests/test_session.py tests/test_checkpoints.py tests/cli/test_keeping.py",
    ),
    Row(
        fault="kill -9 while a message of the recording is written",
        outcome="the run that goes on cuts it off: all parts can be read",
        test="tests/run_folder/test_recording.py",
    ),
    Row(
        fault="a checkpoint that is damaged, or of another log, method, version",
        outcome="one line, exit 2, all stays",
        test="tests/run_folder/test_checkpoint.py tests/core/test_frozen_state.py",
    ),
    Row(
        fault="a clock that begins again within a bag",
        outcome="two runs by recording times, or in the order of the file where these begin again too; told",
        test="tests/logs/test_bag_restarts.py",
    ),
    Row(
        fault="days in one building",
        outcome="local maps of places known well merge into these; what is kept of scans goes to the disk",
        test="tests/loop_closure/test_known_places.py tests/graph/test_merged_nodes.py",
    ),
    Row(
        fault="measurements or covariances out of sense; the solver throws",
        outcome="that factor is dropped with an event",
        test="tests/graph/test_pose_graph.py tests/localization/test_guarded_graph.py -k bad or taken_back or noted",
    ),
    Row(
        fault="laser covered or frozen",
        outcome="the odometry alone, covariance grows, told",
        test="tests/localization/test_blind_scans.py tests/test_cases.py -k blind or covered or same",
    ),
    Row(
        fault="half of the beams covered; the floor seen from a ramp",
        outcome="kept out of match and map, told",
        test="tests/test_pipeline_riding.py tests/detection/test_wide_kernels.py tests/diagnosis/test_come_up.py",
    ),
    Row(
        fault="a match that leaps away from odometry that goes on as before",
        outcome="held, until what was seen from elsewhere proves it or three scans say the same",
        test="tests/localization/test_recent_scans.py tests/localization/test_map_matching.py -k believed or anew",
    ),
    Row(
        fault="wheels that slip make up a turn, down a bare corridor",
        outcome="the turn is taken back, told as a contradiction; the way stays the odometry's",
        test="tests/localization/test_map_matching.py -k made_up",
    ),
    Row(
        fault="odometry that sticks, dies, never moves or counts backward",
        outcome="the laser decides, told as a contradiction; in a bare corridor the way is as unsure as both are apart",
        test="tests/odometry/test_doubt.py tests/test_pipeline_odometry.py",
    ),
    Row(
        fault="an observer of one's own fails",
        outcome="the run ends, its results are kept",
        test="tests/test_observer.py -k fails or begin",
    ),
)


def judge(row: Row) -> str:
    """Run a row's tests; gives how many passed, or which failed."""
    files, _, words = row.test.partition(" -k ")
    argv = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *files.split()]
    done = subprocess.run(
        [*argv, *(["-k", words] if words else [])], cwd=ROOT, capture_output=True, text=True, check=False
    )
    failed = [line.split()[1] for line in done.stdout.splitlines() if line.startswith("FAILED")]
    if failed or done.returncode:
        return f"FAILED: {', '.join(failed) or done.stdout.strip().splitlines()[-1]}"
    dots = [line.split("[")[0] for line in done.stdout.splitlines() if line.rstrip().endswith("%]")]
    n_passed, n_skipped = (sum(line.count(sign) for line in dots) for sign in ".s")
    return f"{n_passed} passed" + (f", {n_skipped} skipped" if n_skipped else "")


FIGURES = ("killed_runs", "bad_disks", "fuzzed_inputs", "long_drive")
"""Tables of experiments that belong to it."""

PAGE = ROOT / "docs" / "faults.md"


def page() -> str:
    """``docs/faults.md``: the table without results, since `make test` runs them, and the figures of experiments."""
    lines = [
        "# What happens when something goes wrong",
        "",
        "Made by `python -m experiments.fault_table --page`; without `--page` it runs the tests.",
        "",
        "| fault | what happens | tests that hold it |",
        "|---|---|---|",
        *(f"| {row.fault} | {row.outcome} | `{row.test}` |" for row in ROWS),
    ]
    for name in FIGURES:
        path = ROOT / "experiments" / "tables" / f"{name}.md"
        if path.exists():
            title, *rest = path.read_text(encoding="utf-8").rstrip().splitlines()
            lines += ["", f"#{title}", *(f"#{line}" if line.startswith("## ") else line for line in rest)]
    return "\n".join(lines) + "\n"


def main() -> int:
    """Print the table; exit code 1 where a test fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--list", action="store_true", help="run nothing")
    parser.add_argument("--only", default="", help="rows whose fault has this in it")
    parser.add_argument("--page", action="store_true", help="run nothing, write docs/faults.md")
    options = parser.parse_args()
    if options.page:
        PAGE.write_text(page(), encoding="utf-8")
        return 0
    print("| fault | what happens | how tested | result |\n|---|---|---|---|")
    is_failed = False
    for row in (row for row in ROWS if options.only in row.fault):
        start = time.monotonic()
        result = "-" if options.list else f"{judge(row)}, {time.monotonic() - start:.0f} s"
        is_failed = is_failed or "FAILED" in result
        print(f"| {row.fault} | {row.outcome} | `{row.test}` | {result} |", flush=True)
    return int(is_failed)


if __name__ == "__main__":
    sys.exit(main())
