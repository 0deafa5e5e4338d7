"""Settings and fixtures of all tests."""

from pathlib import Path

import hypothesis
import numpy as np
import pytest

from tests.real import data_directory

# compiling a kernel and a busy machine both make a first example slow
hypothesis.settings.register_profile("default", deadline=None, max_examples=50)
hypothesis.settings.load_profile("default")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.fixture(scope="session")
def recorded_data() -> Path:
    """The folder of the recorded logs; the test is skipped where there is none."""
    path = data_directory()
    if not path.is_dir():
        pytest.skip(f"no recorded logs: {path} is not a folder; set SLAMMOT_DATA to where they are")
    return path
