"""Tests on recorded logs: in $SLAMMOT_DATA, else in ../shared/data seen from the project's root.

Small logs that must not go wrong again are in $SLAMMOT_CASES, else in ../shared/cases.
"""

import os
from pathlib import Path

PROJECT_ROOT = Path(__file__).resolve().parents[2]


def data_directory() -> Path:
    """Where the recorded logs should be; the folder need not exist."""
    named = os.environ.get("SLAMMOT_DATA")
    return Path(named) if named else PROJECT_ROOT.parent / "shared" / "data"


def cases_directory() -> Path:
    """Where the small logs should be; the folder need not exist."""
    named = os.environ.get("SLAMMOT_CASES")
    return Path(named) if named else PROJECT_ROOT.parent / "shared" / "cases"
