import numpy as np
import pytest

from slammot_graph.odometry.robust_fit import few_samples, long_run_variance


@pytest.mark.parametrize("n", [26, 40, 100])
def test_the_interval_of_few_samples_holds_what_it_says(n: int) -> None:
    rng = np.random.default_rng(n)
    rows = rng.normal(0.0, 1.0, (2000, n, 1))
    sums = rows.sum(axis=1)[:, 0]
    stds = np.sqrt([float(long_run_variance(row)[0, 0]) for row in rows])
    covered = np.mean(np.abs(sums) < 1.96 * few_samples(n) * stds)
    assert 0.93 < covered < 0.98
    assert np.mean(np.abs(sums) < 1.96 * stds) < covered - 0.01


def test_many_samples_need_no_more() -> None:
    assert few_samples(1_000_000) == pytest.approx(1.0, abs=1e-4)
    assert few_samples(5) == few_samples(13)  # no more lags than rows
