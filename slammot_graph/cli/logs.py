"""The commands that write logs: `simulate` and `inject`."""

import itertools
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from slammot_graph.cli.console import EXIT_OK, check_max_scans, scan_progress, stderr, warn
from slammot_graph.cli.files import prepare_file
from slammot_graph.cli.reading import DEFAULT_READING, Reading
from slammot_graph.core.errors import InputError

if TYPE_CHECKING:
    from slammot_graph.core.types import FloatArray
    from slammot_graph.logs import LaserLog


def simulate_command(
    scenario: Annotated[str, tyro.conf.arg(metavar="SCENARIO")],
    /,
    *,
    output: Annotated[Path, tyro.conf.arg(metavar="LOG.npz")],
    seed: Annotated[int, tyro.conf.arg(metavar="S")] = 0,
    people: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    noise_scale: Annotated[float, tyro.conf.arg(metavar="X")] = 1.0,
) -> int:
    """Simulate a log with exact truth for poses, beams and objects.

    Parameters
    ----------
    scenario
        One of one-walker, two-walkers, lab, office, corridor, hall, crowd, building, fast-turns, two-lasers.
    output
        The log to write.
    seed
        Equal seeds give equal logs.
    people
        How many, in place of the scenario's own number.
    noise_scale
        Multiply the errors of the odometry by this.
    """
    write_simulation(scenario, output, seed=seed, people=people, noise_scale=noise_scale)
    return EXIT_OK


def inject_command(
    log: Annotated[Path, tyro.conf.arg(metavar="LOG")],
    /,
    *,
    people: Annotated[int, tyro.conf.arg(metavar="N")],
    seed: Annotated[int, tyro.conf.arg(metavar="S")] = 0,
    output: Annotated[Path, tyro.conf.arg(metavar="LOG.npz")],
    reference: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    max_scans: Annotated[int | None, tyro.conf.arg(metavar="K")] = None,
    reading: Reading = DEFAULT_READING,
) -> int:
    """Copy a recorded log with people in it who cross the beams, and exact labels of those beams.

    They walk where the log's own scans saw free space; all other beams stay as recorded.

    Parameters
    ----------
    log
        As for `slammot-graph run`.
    people
        How many.
    seed
        Equal seeds give equal logs.
    output
        The log to write; its poses are those of the reference.
    reference
        A run folder of the same log, whose trajectory says where the robot was; by default `graph` is run first.
    max_scans
        Take the log's first ones only.
    reading
        What of the log is read, and how.
    """
    check_max_scans(max_scans)
    for name, value in (("people", people), ("seed", seed)):
        if value < 0:
            raise InputError(f"--{name} must be at least 0, not {value}")
    if output.suffix != ".npz":
        raise InputError(f"{output}: the name of --output must end in .npz")

    from slammot_graph.logs import write_npz_log
    from slammot_graph.run_folder.atomic import atomic_path
    from slammot_graph.simulation import inject

    opened = reading.open(log)
    if output.exists() and output.samefile(log):
        raise InputError(f"{output}: is the recorded log itself; name another --output")
    prepare_file(output)
    T_map_base = (
        _run_reference(opened, max_scans)
        if reference is None
        else _read_reference(reference, opened, max_scans)
    )
    made = inject(opened, T_map_base, n_people=people, seed=seed, max_scans=max_scans)
    with atomic_path(output) as path:
        write_npz_log(path, **made.arrays(), poses_are_estimates=True)
    warn(opened)
    n_seen = len(set(made.object_id[made.is_moving].tolist()))
    share = made.is_moving.sum() / max(1, sum(int(scan.is_valid().sum()) for scan in made))
    stderr().print(
        f"{log.name} with seed {seed} is in {output}: {made.n_scans} scans,"
        f" {people} people, {n_seen} of them seen, {share:.1%} of the valid beams on them",
        soft_wrap=True,
    )
    return EXIT_OK


def write_simulation(
    scenario: str, output: Path, *, seed: int, people: int | None, noise_scale: float
) -> None:
    """Simulate a log, write it and say so."""
    from slammot_graph.run_folder.atomic import atomic_path
    from slammot_graph.simulation import simulate

    prepare_file(output)
    simulated = simulate(scenario, seed=seed, n_people=people, noise_scale=noise_scale)
    with atomic_path(output) as path:
        simulated.write(path)
    stderr().print(f"{scenario} with seed {seed} is in {output}", soft_wrap=True)


def _run_reference(log: "LaserLog", max_scans: int | None) -> "FloatArray":
    """Where `graph` says that the robot was."""
    from slammot_graph.run import Run

    run = Run(log, "graph", max_scans=max_scans)
    with scan_progress(log, run.method, max_scans) as show:
        for n_scans, _ in enumerate(run, start=1):
            show(n_scans)
    return run.result().T_map_base


def _read_reference(directory: Path, log: "LaserLog", max_scans: int | None) -> "FloatArray":
    """The trajectory of a run folder, which must be one of this log; `inject` looks at its length."""
    import numpy as np

    from slammot_graph.core.stamps import have_same_times
    from slammot_graph.run_folder.tum import read_trajectory

    stamps, T_map_base = read_trajectory(directory / "trajectory.tum")
    of_log = np.array([scan.stamp for scan in itertools.islice(log, max_scans)])
    if not len(of_log):
        raise InputError(f"{log.path}: none of its {log.n_scans} scans is usable")
    if len(stamps) and not have_same_times(stamps, of_log):
        raise InputError(
            f"{directory}: its scans have other times than those of {log.path};"
            " name a run of this log as --reference"
        )
    return T_map_base
