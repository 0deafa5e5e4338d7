"""The table of faults names tests that are there, and its page is the one in the docs."""

import pytest

from experiments.fault_table import PAGE, ROOT, ROWS, Row, page


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.fault)
def test_a_row_names_tests_that_are_there(row: Row) -> None:
    files, _, words = row.test.partition(" -k ")
    texts = [(ROOT / name).read_text(encoding="utf-8") for name in files.split()]
    names = [line for text in texts for line in text.splitlines() if line.startswith("def test_")]
    for word in words.split(" or ") if words else []:
        assert any(word in name for name in names), word


def test_the_page_is_up_to_date() -> None:
    assert PAGE.read_text(encoding="utf-8") == page()
