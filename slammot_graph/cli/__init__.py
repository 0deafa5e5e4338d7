"""The command line ``slammot-graph``: each command is a function, and `main` turns errors into exit codes.

A file for each group of commands: it parses, calls `run` or what lies above it, and prints.
Imports no part of a method (`tests/test_architecture.py` lists what it may); whatever is heavy (gtsam, rerun,
matplotlib, kiss_icp) is imported by the command that needs it.
"""

import os
import sys
from collections.abc import Sequence

import tyro

from slammot_graph import __version__
from slammot_graph.cli.calibrating import calibrate_command
from slammot_graph.cli.checking import check_command
from slammot_graph.cli.console import (
    EXIT_INTERRUPTED,
    EXIT_OK,
    EXIT_USER_ERROR,
    PROGRAM,
    complain,
    stderr,
    stdout,
)
from slammot_graph.cli.judging import compare_command, evaluate_command
from slammot_graph.cli.logs import inject_command, simulate_command
from slammot_graph.cli.maps import edit_command, merge_command
from slammot_graph.cli.methods import config_command, methods_command
from slammot_graph.cli.running import demo_command, run_command
from slammot_graph.cli.showing import animate_command, view_command
from slammot_graph.cli.studying import report_command, study_command
from slammot_graph.core.errors import SlammotError

__all__ = ["main"]

TRACEBACK_VARIABLE = "SLAMMOT_TRACEBACK"
"""With this set in the environment an unexpected exception is shown with its traceback."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments without the program's name; those of the process if left out.

    Returns
    -------
    int
        0 if all went well, 1 where `check` found an error in a log, 2 after a user's mistake (with one line on
        stderr) and without a command (with the help), 130 after Ctrl-C.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    try:
        return _obey(words)
    except SystemExit as stop:  # tyro has shown the help or what is wrong with the arguments
        return stop.code if words and isinstance(stop.code, int) else EXIT_USER_ERROR
    except SlammotError as error:
        return complain(str(error))
    except BrokenPipeError:  # the reader of our output has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_USER_ERROR
    except Exception as error:
        if os.environ.get(TRACEBACK_VARIABLE):
            raise
        return complain(_told(error))
    except KeyboardInterrupt:
        stderr().print("interrupted")
        return EXIT_INTERRUPTED


def _told(error: Exception) -> str:
    """Say in one line what went wrong that no part of the program foresaw."""
    if isinstance(error, OSError):
        place = f"{error.filename}: " if error.filename else ""
        return f"{place}{error.strerror or error}"
    text = " ".join(str(error).split())[:300]
    if isinstance(error, MemoryError):
        return f"not enough memory ({text}); take a coarser grid, a shorter log or another machine"
    return (
        f"unexpected {type(error).__name__}: {text}; a fault of this program: please report it with what"
        f" {TRACEBACK_VARIABLE}=1 shows"
    )


def _obey(words: list[str]) -> int:
    """Run the command that the arguments name; without any, show the help."""
    if words == ["--version"]:
        stdout().print(f"{PROGRAM} {__version__}")
        return EXIT_OK
    code: int = tyro.extras.subcommand_cli_from_dict(
        {
            "run": run_command,
            "check": check_command,
            "view": view_command,
            "animate": animate_command,
            "compare": compare_command,
            "evaluate": evaluate_command,
            "study": study_command,
            "report": report_command,
            "methods": methods_command,
            "config": config_command,
            "calibrate": calibrate_command,
            "simulate": simulate_command,
            "inject": inject_command,
            "demo": demo_command,
            "merge": merge_command,
            "edit": edit_command,
        },
        prog=PROGRAM,
        description="2D laser SLAM among moving people, on a factor graph. --version tells which one this is.",
        args=words or ["--help"],
        config=(tyro.conf.FlagCreatePairsOff,),
    )
    return code
