"""Checkpoints of a run into its folder: a partial run that can be read, and all that is needed to go on from it."""

import time
from pathlib import Path

from slammot_graph.core.errors import InputError
from slammot_graph.run import Run
from slammot_graph.run_folder.checkpoint import CheckpointFile
from slammot_graph.run_folder.directory import clear_later_results
from slammot_graph.run_folder.g2o import write_graph
from slammot_graph.run_folder.summary import write_summary
from slammot_graph.run_folder.tum import write_trajectory

MOST_SHARE = 0.02
"""Of the time of a run: the next checkpoint waits until they take no more."""
FIRST_AFTER_S = 0.5


class Checkpoints:
    """Writes checkpoints of a run, of which they never take more than a small share of the time.

    Parameters
    ----------
    run : Run
    file : CheckpointFile
    folder : Path
        The run folder.
    every_s : float
        How often [s]; 0: never. The first come earlier: as soon as there is anything, and whenever twice as much
        has been computed.

    Attributes
    ----------
    failure : InputError or None
        Why there are none any more.
    """

    def __init__(self, run: Run, file: CheckpointFile, folder: Path, *, every_s: float) -> None:
        self.failure: InputError | None = None
        self._run = run
        self._file = file
        self._folder = folder
        self._every_s = every_s
        self._begun_s = time.monotonic()
        self._due_s = self._begun_s + FIRST_AFTER_S if every_s > 0.0 else float("inf")

    def after_step(self) -> None:
        """Write one if it is due."""
        if time.monotonic() >= self._due_s:
            self.write()

    def write(self) -> None:
        """Write one now; where that is not possible, there are none any more."""
        if self._every_s <= 0.0 or self.failure is not None:
            return
        start_s = time.monotonic()
        try:
            self._file.write(self._run.freeze())
            self._write_partial_run()
        except InputError as error:
            self.failure = InputError(f"no checkpoints any more: {error}")
            self._due_s = float("inf")
            self._file.remove()
            return
        now_s = time.monotonic()
        took_s = now_s - start_s
        wait_s = max(min(self._every_s, now_s - self._begun_s), took_s * (1.0 / MOST_SHARE - 1.0))
        self._due_s = now_s + wait_s

    def _write_partial_run(self) -> None:
        partial = self._run.trajectory()
        clear_later_results(self._folder)
        write_trajectory(self._folder / "trajectory.tum", partial.stamps, partial.T_map_base)
        write_summary(self._folder / "summary.json", partial)
        if len(partial.nodes):
            write_graph(self._folder / "graph.g2o", partial.nodes, partial.edges)
