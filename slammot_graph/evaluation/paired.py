"""Statistics of paired measurements: medians with bootstrap intervals, Wilcoxon's test, Holm's correction."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

N_BOOTSTRAP = 2000


def bootstrap_median(values: Sequence[float]) -> tuple[float, float, float]:
    """Median and the bounds of its 95% interval (percentile bootstrap, seeded); NaN over nothing.

    Parameters
    ----------
    values : sequence of float
        NaN is left out.
    """
    kept = np.array([value for value in values if not math.isnan(value)])
    if kept.size == 0:
        return math.nan, math.nan, math.nan
    draws = np.random.default_rng(0).integers(kept.size, size=(N_BOOTSTRAP, kept.size))
    low, high = np.percentile(np.median(kept[draws], axis=1), [2.5, 97.5])
    return float(np.median(kept)), float(low), float(high)


def paired_p(a: Sequence[float], b: Sequence[float]) -> float:
    """Two-sided paired Wilcoxon signed-rank test; NaN under two pairs, 1 if no pair differs."""
    from scipy import stats

    pairs = [(x, y) for x, y in zip(a, b, strict=True) if not (math.isnan(x) or math.isnan(y))]
    difference = np.array([x - y for x, y in pairs])
    if len(difference) < 2:
        return math.nan
    if not difference.any():
        return 1.0
    return float(stats.wilcoxon(difference).pvalue)


def holm(p_values: Mapping[str, float]) -> dict[str, float]:
    """Holm's correction of the p-values of one family; NaN stays and is not counted."""
    ordered = sorted((p, key) for key, p in p_values.items() if not math.isnan(p))
    corrected = dict(p_values)
    running = 0.0
    for k, (p, key) in enumerate(ordered):
        running = max(running, min(1.0, (len(ordered) - k) * p))
        corrected[key] = running
    return corrected


def median_text(values: Sequence[float], n_decimals: int = 3) -> str:
    """Median with its 95% interval as text, "-" over nothing."""
    median, low, high = bootstrap_median(values)
    if math.isnan(median):
        return "-"
    return f"{median:.{n_decimals}f} [{low:.{n_decimals}f}, {high:.{n_decimals}f}]"


def p_text(p: float) -> str:
    """A p-value as text."""
    if math.isnan(p):
        return "-"
    return f"{p:.1e}" if p < 0.001 else f"{p:.3f}"
