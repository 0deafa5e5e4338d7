"""Save a result as a run folder with its picture, and load it: where `run_folder` and `viz` are both known."""

from pathlib import Path

from slammot_graph.core.results import RunResult
from slammot_graph.core.saved_run import RunFolder
from slammot_graph.run_folder.atomic import replacing
from slammot_graph.run_folder.directory import claimed_output
from slammot_graph.run_folder.reader import read_run_folder
from slammot_graph.run_folder.writer import write_each, write_run_folder


def save_run(result: RunResult, directory: str | Path, *, overwrite: bool = False) -> None:
    """Write a run into a folder that is new, empty, or holds a run that may be replaced; see `RunResult.save`."""
    with claimed_output(directory, overwrite=overwrite):
        write_run(result, directory)


def write_run(result: RunResult, directory: str | Path) -> None:
    """Write the files of a run and ``overview.png``; a recording that is already there stays.

    Raises
    ------
    InputError
        A file cannot be written; the text names it. All others were tried before.
    """

    def write_picture() -> None:
        from slammot_graph.viz.overview import draw_overview

        with replacing(Path(directory) / "overview.png") as path:
            draw_overview(
                result,
                path,
                log_name=None if result.log.path is None else result.log.path.name,
                moving_points=result.moving_points,
            )

    write_each(lambda: write_run_folder(directory, result), write_picture)


def load_run(directory: str | Path) -> RunFolder:
    """Load a run folder, of `RunResult.save`, of the command line, or of another program.

    Raises
    ------
    InputError
        There is no such folder or no trajectory in it, a file in it is damaged, or its files are of different
        runs; the text names the file.
    """
    return read_run_folder(directory)
