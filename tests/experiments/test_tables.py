"""The statistics in the tables, and the tables themselves."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from experiments.common import Options
from experiments.tables import (
    Table,
    bootstrap_median,
    holm,
    median_interval,
    number,
    p_text,
    paired_p,
    write_tables,
)

NAN = float("nan")


def test_holm_by_hand() -> None:
    # in order: 4 x 0.005, 3 x 0.01, 2 x 0.03, and 1 x 0.04, which is under the one before it
    p_values = {"a": 0.01, "b": 0.04, "c": 0.03, "d": 0.005}
    expected = {"a": 0.03, "b": 0.06, "c": 0.06, "d": 0.02}
    assert holm(p_values) == pytest.approx(expected)
    assert list(holm(p_values)) == list(p_values)
    assert p_values["a"] == 0.01


def test_holm_stops_at_one_and_leaves_out_what_is_not_a_number() -> None:
    corrected = holm({"a": 0.4, "b": NAN, "c": 0.6, "d": 0.02})
    assert corrected["d"] == pytest.approx(0.06)
    assert corrected["a"] == pytest.approx(0.8)
    assert corrected["c"] == pytest.approx(0.8)
    assert math.isnan(corrected["b"])
    assert holm({"a": 0.7, "b": 0.8}) == {"a": 1.0, "b": 1.0}
    assert holm({}) == {}


def test_holm_never_reorders(rng: np.random.Generator) -> None:
    raw = {f"{k}": float(p) for k, p in enumerate(rng.uniform(0.0, 0.2, 20))}
    corrected = holm(raw)
    ordered = sorted(raw, key=lambda key: raw[key])
    values = [corrected[key] for key in ordered]
    assert values == sorted(values)
    assert values[0] == pytest.approx(min(1.0, 20 * raw[ordered[0]]))
    assert all(raw[key] <= corrected[key] <= 1.0 for key in raw)


@pytest.mark.parametrize("n", [2, 5, 20, 80])
def test_paired_p_is_that_of_scipy(n: int, rng: np.random.Generator) -> None:
    a, b = rng.normal(0.0, 1.0, n), rng.normal(0.3, 1.0, n)
    assert paired_p(list(a), list(b)) == pytest.approx(stats.wilcoxon(a, b).pvalue, rel=1e-9)
    assert paired_p(list(a), list(b)) == pytest.approx(paired_p(list(b), list(a)), rel=1e-9)


def test_paired_p_by_hand() -> None:
    # of the 2^5 ways of the signs two are as extreme as all alike
    assert paired_p([1.0, 2.0, 3.0, 4.0, 5.0], [0.9, 1.8, 2.7, 3.6, 4.5]) == pytest.approx(2 / 32)


def test_paired_p_drops_a_pair_without_a_number() -> None:
    a, b = [1.0, 2.0, NAN, 4.0, 5.0, 6.0], [0.5, NAN, 3.0, 3.0, 3.0, 3.0]
    expected = stats.wilcoxon([0.5, 1.0, 2.0, 3.0]).pvalue
    assert paired_p(a, b) == pytest.approx(expected)


def test_paired_p_of_few_and_of_equal_pairs() -> None:
    assert math.isnan(paired_p([], []))
    assert math.isnan(paired_p([1.0], [2.0]))
    assert math.isnan(paired_p([1.0, NAN], [2.0, 3.0]))
    assert paired_p([1.0, 2.0, 3.0], [1.0, 2.0, 3.0]) == 1.0
    with pytest.raises(ValueError, match="zip"):
        paired_p([1.0], [1.0, 2.0])


@pytest.mark.parametrize("n", [1, 2, 3, 10, 101])
def test_bootstrap_interval_holds_the_median(n: int, rng: np.random.Generator) -> None:
    values = list(rng.lognormal(size=n))
    median, low, high = bootstrap_median(values)
    assert median == pytest.approx(np.median(values))
    assert min(values) <= low <= median <= high <= max(values)
    assert (low < high) == (n > 1)
    assert bootstrap_median(values) == (median, low, high)


def test_bootstrap_interval_covers_the_true_median(rng: np.random.Generator) -> None:
    n_covered = 0
    for sample in rng.normal(3.0, 1.0, (100, 40)):
        _, low, high = bootstrap_median(list(sample))
        n_covered += low <= 3.0 <= high
    assert n_covered >= 88


def test_bootstrap_leaves_out_what_is_not_a_number() -> None:
    assert bootstrap_median([1.0, NAN, 2.0, 3.0]) == bootstrap_median([1.0, 2.0, 3.0])
    assert all(math.isnan(value) for value in bootstrap_median([NAN]))
    assert all(math.isnan(value) for value in bootstrap_median([]))


def test_numbers_as_text() -> None:
    assert median_interval([2.0, 2.0]) == "2.000 [2.000, 2.000]"
    assert median_interval([2.0], 1) == "2.0 [2.0, 2.0]"
    assert median_interval([NAN]) == "-"
    assert (number(0.12345), number(0.12345, 1), number(NAN)) == ("0.123", "0.1", "-")
    assert (p_text(0.04), p_text(0.00012), p_text(NAN)) == ("0.040", "1.2e-04", "-")


def test_markdown() -> None:
    table = Table(heading="Errors", columns=["method", "ATE"], rows=[["graph", "0.1"], ["icp", "0.2"]])
    assert table.markdown().splitlines() == [
        "## Errors",
        "",
        "| method | ATE |",
        "| :-- | --: |",
        "| graph | 0.1 |",
        "| icp | 0.2 |",
    ]


def test_written_tables_say_where_they_come_from(tmp_path: Path) -> None:
    table = Table(heading="Errors", columns=["method", "ATE"], rows=[["graph", "0.1"]])
    options = Options(output=tmp_path, quick=True, seeds=3, jobs=1)
    path = write_tables("made", "A title", ["A note."], [table, table], options)
    assert path == tmp_path / "tables" / "made.md"
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# A title\n\nA note.\n\n- Command: `python -m experiments.made --quick --seeds 3")
    assert "Quick mode" in text
    assert text.count(table.markdown()) == 2
    assert all(name in text for name in ("Machine: ", "Revision: ", "gtsam ", "kiss-icp "))
    write_tables("made", "A title", ["A note."], [table], Options(output=tmp_path))
    assert "Quick mode" not in path.read_text(encoding="utf-8")
