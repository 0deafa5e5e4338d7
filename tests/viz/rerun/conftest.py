"""Recordings are made in rerun's strict mode."""

from collections.abc import Iterator

import pytest
import rerun as rr


@pytest.fixture(autouse=True, scope="module")
def strict() -> Iterator[None]:
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)
