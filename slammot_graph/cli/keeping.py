"""Checkpoints of `run`, and how it goes on from one."""

import uuid
from pathlib import Path
from typing import TYPE_CHECKING

from slammot_graph.cli.console import stderr
from slammot_graph.core.errors import InputError

if TYPE_CHECKING:
    from slammot_graph.checkpoints import Checkpoints
    from slammot_graph.run import Run
    from slammot_graph.run_folder.checkpoint import CheckpointFile


class Keeping:
    """What is kept of a run while it goes on.

    Parameters
    ----------
    output : Path
        The run folder.
    every_s : float
        How often [s]; 0: never.
    resume : bool
        Go on with the run that is in the folder.

    Attributes
    ----------
    recording_id : str
        Of all parts of the recording.
    """

    def __init__(self, output: Path, *, every_s: float = 0.0, resume: bool = False) -> None:
        from slammot_graph.run_folder.checkpoint import notes_of

        self.resume = resume
        known = notes_of(output).get("recording") if resume else None
        self.recording_id = known if isinstance(known, str) else str(uuid.uuid4())
        self._output = output
        self._every_s = every_s
        self._file: CheckpointFile | None = None
        self._checkpoints: Checkpoints | None = None

    def begin(self, run: "Run") -> None:
        """Let the run go on from the folder's checkpoint if that is wanted, and make checkpoints of it.

        Raises
        ------
        InputError
            The folder holds a run that has ended, or the checkpoint is damaged or of something else.
        """
        from slammot_graph.checkpoints import Checkpoints
        from slammot_graph.run_folder.checkpoint import CheckpointFile
        from slammot_graph.run_folder.directory import keep_recording, prepare_output
        from slammot_graph.run_folder.summary import read_summary

        self._file = CheckpointFile(self._output, {"recording": self.recording_id})
        if self.resume:
            frozen = self._file.read()
            if frozen is not None:
                run.resume(frozen)
                keep_recording(self._output)
                done = f"going on after {frozen.n_scans} scans"
                if frozen.state is None:
                    done = "the state of this method cannot be kept: going through the log from its beginning"
                stderr().print(done, soft_wrap=True)
            elif read_summary(self._output / "summary.json").get("is_complete"):
                raise InputError(
                    f"{self._output}: holds a run that has ended, there is nothing to go on with; pass --overwrite"
                    " to replace it, or name another --output"
                )
            else:
                prepare_output(self._output, overwrite=True)
        self._checkpoints = Checkpoints(run, self._file, self._output, every_s=self._every_s)

    def after_step(self) -> None:
        """Make a checkpoint if one is due."""
        if self._checkpoints is not None:
            self._checkpoints.after_step()

    def interrupted(self) -> None:
        """Make a last one."""
        if self._checkpoints is not None:
            self._checkpoints.write()

    def failures(self) -> list[Exception]:
        """Tell why there were no more checkpoints."""
        failure = None if self._checkpoints is None else self._checkpoints.failure
        return [] if failure is None else [failure]

    def can_go_on(self) -> bool:
        """Tell whether there is a checkpoint to go on from."""
        return self._file is not None and self._file.exists()

    def end(self) -> None:
        """Remove the checkpoint: the run is over, or its results need the space."""
        if self._file is not None:
            self._file.remove()
