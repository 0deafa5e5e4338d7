"""Settings and fixtures of all tests."""

import os
from pathlib import Path

import hypothesis
import numpy as np
import pytest

from tests.real import cases_directory, data_directory

# compiling a kernel and a busy machine both make a first example slow
hypothesis.settings.register_profile("default", deadline=None, max_examples=50)
hypothesis.settings.register_profile("long", deadline=None, max_examples=20_000)  # make fuzz
hypothesis.settings.load_profile(os.environ.get("SLAMMOT_HYPOTHESIS", "default"))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip what is marked `real` or `cases` where there are no such logs."""
    if item.get_closest_marker("real") and not data_directory().is_dir():
        pytest.skip(
            f"no recorded logs: {data_directory()} is not a folder; set SLAMMOT_DATA to where they are"
        )
    if item.get_closest_marker("cases") and not cases_directory().is_dir():
        pytest.skip(
            f"no small logs: {cases_directory()} is not a folder; set SLAMMOT_CASES to where they are"
        )


@pytest.fixture(scope="session")
def cases() -> Path:
    """The folder of the small logs that went wrong once."""
    return cases_directory()


@pytest.fixture(scope="session")
def recorded_data() -> Path:
    """The folder of the recorded logs."""
    return data_directory()
