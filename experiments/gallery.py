"""All experiments: what `make tables` runs, in which order, and what the documentation's gallery shows of each.

``python -m experiments.gallery`` remakes the tables that are not of today's code, one experiment after the other. Each
keeps its finished cells, so that whatever ends it, the same command goes on; names run these alone, ``--list`` tells
what is to be done. Options after ``--`` go to every experiment, as ``-- --quick --output runs/tables``.
"""

import argparse
import re
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from experiments.common import ROOT, say, version_of

TABLES = ROOT / "experiments" / "tables"


@dataclass(frozen=True, kw_only=True)
class Entry:
    """An experiment.

    Attributes
    ----------
    name : str
        Of its module.
    what : str
        What it asks, in one line.
    arguments : sequence of str
        Of the committed table.
    figure : str, optional
        Its picture in `experiments/figures`.
    needs_logs : bool
        Reads recorded logs.
    """

    name: str
    what: str
    arguments: Sequence[str] = ()
    figure: str | None = None
    needs_logs: bool = False

    @property
    def command(self) -> str:
        """As a person gives it."""
        return " ".join(["python -m", f"experiments.{self.name}", *self.arguments])

    @property
    def table(self) -> Path:
        """Its committed table."""
        return TABLES / f"{self.name}.md"


ENTRIES = (
    Entry(name="paper_map_and_ellipses", what="The paper's Fig. 1 and 3", figure="paper_map_and_ellipses"),
    Entry(name="paper_one_walker", what="The paper's Fig. 5 and 6", figure="paper_one_walker"),
    Entry(name="paper_two_walkers", what="The paper's Fig. 7 and 8", figure="paper_two_walkers"),
    Entry(name="paper_search", what="What the paper leaves open: step, rejection, ellipse"),
    Entry(name="paper_judge", what="The paper's methods against the wheels, on seeds of their own"),
    Entry(name="paper_claim", what="Does the paper's filter help its ICP?", figure="paper_claim"),
    Entry(name="ladder", what="From the paper to graph, one change a preset", needs_logs=True),
    Entry(name="ablation", what="Every method on every scenario"),
    Entry(name="noise_sweep", what="Odometry noise against people", figure="noise_sweep"),
    Entry(name="consistency", what="Are the covariances consistent?", arguments=("--seeds", "20")),
    Entry(name="match_covariances", what="Whose covariance of a match is right?", arguments=("--seeds", "3")),
    Entry(
        name="covariance_ablation",
        what="Which covariance for the moving-point test?",
        arguments=("--seeds", "12"),
        figure="covariance_over_path",
    ),
    Entry(name="fit_p_moving", what="The weights of p_moving"),
    Entry(
        name="reliability",
        what="Is p_moving calibrated?",
        arguments=("--seeds", "4"),
        figure="reliability",
        needs_logs=True,
    ),
    Entry(
        name="moving_points", what="Moving points in real logs", arguments=("--seeds", "3"), needs_logs=True
    ),
    Entry(
        name="extra_moving_points",
        what="What moves beyond the labels",
        figure="extra_moving_points",
        needs_logs=True,
    ),
    Entry(name="walking_along", what="People who walk with the robot", needs_logs=True),
    Entry(name="tracking", what="Tracks of moving objects", arguments=("--seeds", "20")),
    Entry(name="riding_along", what="Covers and ramps: what rides along"),
    Entry(name="sweep", what="Lasers that sweep"),
    Entry(name="beam_times", what="Beam times that are told wrong", needs_logs=True),
    Entry(name="odometry_faults", what="Odometry that is wrong", arguments=("--scenarios", "lab")),
    Entry(name="any_robot", what="With the wheels, and by the laser alone", needs_logs=True),
    Entry(name="freiburg", what="Recorded logs against their true relations", needs_logs=True),
    Entry(name="recorded_logs", what="All recorded logs", needs_logs=True),
    Entry(name="false_closures", what="False closures put in", needs_logs=True),
    Entry(name="large_building", what="A large building"),
    Entry(name="lost_robot", what="A kidnapped robot", needs_logs=True),
    Entry(name="place_recognition", what="Recognising places", needs_logs=True),
    Entry(name="kiss_search", what="Settings of kiss-icp", needs_logs=True),
    Entry(
        name="saved_maps",
        what="Runs in a map of an earlier run",
        arguments=("--seeds", "15"),
        needs_logs=True,
    ),
    Entry(name="bad_disks", what="Disks that are full, folders that may not be written"),
    Entry(name="killed_runs", what="Runs that are killed and go on"),
    Entry(name="fuzzed_inputs", what="Damaged input to every reader"),
    Entry(name="long_drive", what="A day of driving"),
    Entry(name="study_overhead", what="What a study costs beside its cells"),
    Entry(name="speed", what="Time of a step", needs_logs=True),
)


def code_of(entry: Entry) -> str:
    """Version of the code that an experiment runs, its tables included."""
    return version_of(f"experiments.{entry.name}:experiment")


def told_code(table: Path) -> str | None:
    """Version of the code that a table says it is of; None where it does not."""
    found = re.search(r"^- Code: (\w+) of version", table.read_text(encoding="utf-8"), re.MULTILINE)
    return found[1] if found else None


def is_current(entry: Entry) -> bool:
    """Whether the committed table is of today's code."""
    return entry.table.is_file() and told_code(entry.table) == code_of(entry)


def main(argv: Sequence[str] | None = None) -> int:
    """Remake tables; the exit code is 1 where an experiment failed."""
    words = list(sys.argv[1:] if argv is None else argv)
    more = words[words.index("--") + 1 :] if "--" in words else []
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="these experiments; by default all")
    parser.add_argument("--list", action="store_true", help="tell which tables are of other code, and stop")
    parser.add_argument("--all", action="store_true", help="also those of today's code")
    chosen = parser.parse_args(words[: words.index("--")] if "--" in words else words)
    unknown = set(chosen.names) - {entry.name for entry in ENTRIES}
    if unknown:
        say(f"no experiment {', '.join(sorted(unknown))}; there are {', '.join(e.name for e in ENTRIES)}")
        return 2
    entries = [entry for entry in ENTRIES if not chosen.names or entry.name in chosen.names]
    todo = [entry for entry in entries if chosen.all or not is_current(entry)]
    if chosen.list:
        for entry in entries:
            print(f"{'to do' if entry in todo else 'current':8} {entry.command}")
        return 0
    failed = []
    for number, entry in enumerate(todo, start=1):
        say(f"tables: {number} of {len(todo)}: {entry.command}")
        command = [sys.executable, "-m", f"experiments.{entry.name}", *entry.arguments, *more]
        code = subprocess.run(command, cwd=ROOT, check=False).returncode
        if code in (130, -2):
            say("tables: interrupted; the same command goes on")
            return 130
        failed += [entry.name] if code else []
    if failed:
        say(f"tables: failed: {', '.join(failed)}; the same command tries them again")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
