"""The table of faults names tests that are there."""

import pytest

from experiments.fault_table import ROOT, ROWS, Row


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.fault)
def test_a_row_names_tests_that_are_there(row: Row) -> None:
    files, _, words = row.test.partition(" -k ")
    texts = [(ROOT / name).read_text(encoding="utf-8") for name in files.split()]
    names = [line for text in texts for line in text.splitlines() if line.startswith("def test_")]
    for word in words.split(" or ") if words else []:
        assert any(word in name for name in names), word
