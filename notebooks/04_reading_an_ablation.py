# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Reading an ablation
#
# The tables in `experiments/tables` compare methods over many simulated or recorded runs. This notebook makes a very
# small table of that kind and reads it: paired seeds, a median with its interval, and a test with a correction. It
# compares `graph` with `graph-fixed`, which differ in one field, the covariance in the moving-point test.

# %%
import sys
from collections.abc import Callable

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Markdown, display

from slammot_graph import Run, RunResult
from slammot_graph.evaluation import absolute_error, evaluate_points, relative_error
from slammot_graph.simulation import SimulatedLog, simulate

sys.path += ["..", "."]  # the project's root, from here or as the working folder
from experiments.common import ROOT
from experiments.tables import Table, bootstrap_median, holm, median_interval, p_text, paired_p

# %% [markdown]
# ## A seed is a pair
#
# Everything random in a simulated log comes from its seed: the drive, the slip of the wheels, the noise of the laser,
# the paths of the people. Both methods get the *same* log. So seed 3 is not two independent numbers but a pair, and a
# hard log is hard for both.

# %%
SEEDS = range(8)
METHODS = ("graph", "graph-fixed")
FIGURES: dict[str, Callable[[RunResult, SimulatedLog], float]] = {
    "ATE [mm]": lambda r, log: 1e3 * absolute_error(r.T_map_base, log.T_world_base).translation_m.rmse,
    "RPE over 1 m [mm]": lambda r, log: (
        1e3 * relative_error(r.T_map_base, log.T_world_base, delta=1.0, unit="m").translation_m.rmse
    ),
    "point IoU": lambda r, log: evaluate_points(r.is_moving, log.is_moving, r.is_valid).iou,
}
scores: dict[tuple[str, str], list[float]] = {(method, name): [] for method in METHODS for name in FIGURES}
for seed in SEEDS:
    log = simulate("two-walkers", seed=seed)
    for method in METHODS:
        result = Run(log, method).complete()
        for name, measure in FIGURES.items():
            scores[method, name].append(measure(result, log))

# %% [markdown]
# Each line below is one log, from one method to the other. The lines start at different heights: some logs are harder
# than others. Comparing two clouds of points would drown the difference in that; comparing the two ends of each line
# does not.

# %%
figure, axes = plt.subplots(1, 3, figsize=(11, 3.4), layout="constrained")
for panel, name in zip(axes, FIGURES, strict=True):
    panel.plot([scores[method, name] for method in METHODS], "o-", color="0.4", markersize=4, linewidth=0.8)
    panel.set(xticks=(0, 1), xticklabels=METHODS, xlim=(-0.3, 1.3), ylabel=name)
plt.show()

# %% [markdown]
# ## Median and bootstrap interval
#
# A cell such as `0.004 [0.003, 0.005]` is the median over the seeds and a 95% interval for it. The interval comes from
# the bootstrap: draw as many seeds again, with replacement, take the median, repeat 2,000 times, and keep the middle
# 95% of those medians. It says how much the median would wobble with other seeds. It says nothing about other rooms,
# robots or lasers.
#
# The same can be done with the differences of the pairs, which is the sharper question. Below zero, `graph` has the
# lower value: good for an error, bad for the IoU.

# %%
differences = {name: np.subtract(scores["graph", name], scores["graph-fixed", name]) for name in FIGURES}
figure, axes = plt.subplots(1, 3, figsize=(11, 2.9), layout="constrained")
for panel, (name, values) in zip(axes, differences.items(), strict=True):
    median, low, high = bootstrap_median(values.tolist())
    panel.plot(values, np.linspace(0.2, 0.5, len(values)), "o", color="0.5", label="a pair")
    panel.errorbar(
        median, 0.8, xerr=[[median - low], [high - median]], fmt="s", capsize=4, label="median, 95%"
    )
    panel.axvline(0.0, color="k", linewidth=0.8)
    panel.set(xlabel=f"graph - graph-fixed, {name}", yticks=(), ylim=(0, 1))
figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
plt.show()

# %% [markdown]
# ## Wilcoxon, and Holm
#
# The paired Wilcoxon test asks: if the two methods were alike, how often would the differences lean to one side as much
# as these do? That share is p. It ranks the differences by size, so one wild log cannot decide alone.
#
# With few seeds p cannot become small, however clear the case: if all of n differences lean to one side, p is
# 2 / 2^n. That is one reason for the 20 seeds of the real tables.
#
# Who makes many tests finds something small by chance. Holm's correction pays for that: of k tests, the smallest p is
# multiplied by k, the next by k - 1, and so on.

# %%
p_raw = {name: paired_p(*(scores[method, name] for method in METHODS)) for name in FIGURES}
p_corrected = holm(p_raw)
rows = [
    [
        name,
        *(median_interval(scores[method, name], 2) for method in METHODS),
        p_text(p_raw[name]),
        p_text(p_corrected[name]),
    ]
    for name in FIGURES
]
table = Table(heading="Our small table", columns=["", *METHODS, "p", "p, Holm"], rows=rows)
display(Markdown(table.markdown()))  # type: ignore[no-untyped-call]

# %%
n_seeds = np.arange(3, 21)
figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
axes.semilogy(n_seeds, 2.0 / 2.0**n_seeds, "o-", label="one test")
axes.semilogy(n_seeds, np.minimum(1.0, 11 * 2.0 / 2.0**n_seeds), "o-", label="the best of eleven, after Holm")
axes.axhline(0.05, color="k", linewidth=0.8, label="0.05")
axes.set(xlabel="number of paired seeds", ylabel="smallest p that is possible", xticks=range(4, 21, 4))
axes.legend()
plt.show()

# %% [markdown]
# ## The same rows in the real table
#
# From `experiments/tables/ablation.md`, with 20 seeds. There the p belongs to the absolute error of `graph` against the
# method of the row, corrected over the eleven rivals of `graph`.

# %%
text = (ROOT / "experiments" / "tables" / "ablation.md").read_text(encoding="utf-8")
section = text[text.index("## two-walkers") :].split("\n## ")[0].splitlines()
lines = [line for line in section if line.startswith(("| method |", "| :--", "| graph |", "| graph-fixed |"))]
display(Markdown("\n".join(lines)))  # type: ignore[no-untyped-call]

# %% [markdown]
# ## How to read it
#
# - Look at the size first, then at p. A small p says that a difference is there, not that it is large.
# - A large p is not a proof that two methods are alike. It says that these seeds do not tell them apart.
# - Intervals of two methods may overlap although each pair leans to the same side; for pairs, the test counts.
# - "-" is a figure over nothing: the precision of a method that called no point moving, for instance.
# - The last lines above each table name the command, the machine and the revision that made it.
