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
# # Two runs
#
# A run leaves a map that later runs start from. Here a robot maps a laboratory; a week later some of the furniture
# stands elsewhere, and another run begins at a place that nobody tells it. It is found, it follows its way in the
# first map, and it says what has changed. At last two maps of two robots are merged into one.

# %%
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

from slammot_graph import MapStart, Run, SavedMap, closures_between_runs, edit_map, merge_maps
from slammot_graph.evaluation import absolute_error
from slammot_graph.simulation import SCENARIOS, simulate

LAB = replace(SCENARIOS["lab"], rate_hz=5.0, n_people=1, n_laps=1)
first_log = simulate(LAB, seed=1)
second_log = simulate(replace(LAB, moved=0.2, moved_seed=1), seed=1001)

# %% [markdown]
# ## The first run
#
# `RunResult.saved_map` is what the run folder keeps as `map.slam`: local maps, pose graph, calibration. Its bytes are a
# file with a version and a checksum, without pickled objects.

# %%
first = Run(first_log).complete()
assert first.saved_map is not None
data = first.saved_map.to_bytes()
saved = SavedMap.from_bytes(data)
print(f"{len(saved.nodes)} nodes, {len(saved.submaps)} local maps, {len(saved.keyframe_nodes)} keyframes")
print(f"{len(data) / len(saved.keyframe_nodes):.0f} bytes for each keyframe")

# %% [markdown]
# ## The second run, localized in the map of the first
#
# Until several of its local maps agree on one place, the robot is "lost": its poses are in a frame of their own. The
# poses of the result are in the frame of the map, those from before it was found too.

# %%
localized = Run(second_log, start=MapStart(saved=saved, localize=True)).complete()
n_lost = int(np.count_nonzero(localized.health == "lost"))
error = absolute_error(localized.T_map_base, second_log.T_world_base).translation_m
print(f"found after {n_lost} scans; error {1e3 * error.rmse:.0f} mm (rmse)")

# %% [markdown]
# ## What has changed
#
# Red: what stands where the first run saw nothing. Blue: what is there no more. The map below is that of both runs, as
# things are now.

# %%
assert localized.is_changed is not None
print(f"{np.count_nonzero(localized.is_changed)} points of things that were moved")
figure, axes = plt.subplots(1, 2, figsize=(11, 4.5), sharex=True, sharey=True)
for ax, result, title in zip(axes, (first, localized), ("first run", "both runs"), strict=True):
    (rows, cols), grid = result.grid.p_occupied.shape, result.grid
    x, y = grid.origin
    extent = (x, x + cols * grid.resolution_m, y, y + rows * grid.resolution_m)
    ax.imshow(grid.p_occupied, origin="lower", extent=extent, cmap="gray_r", vmin=0.0, vmax=1.0)
    ax.plot(*result.T_map_base[:, :2].T, linewidth=1.0)
    ax.set_title(title)
axes[1].plot(*localized.new_points.T, ".", color="tab:red", label="new")
axes[1].plot(*localized.gone_points.T, ".", color="tab:blue", label="gone")
axes[1].legend()
plt.show()

# %% [markdown]
# ## Going on with the map
#
# Without `localize` the run becomes a part of the map. The map it leaves has lost what is gone, and holds both runs.

# %%
both = Run(second_log, start=MapStart(saved=saved)).complete().saved_map
assert both is not None
print(f"{len(both.runs)} runs, {len(both.nodes)} nodes, {len(both.submaps)} local maps")

# %% [markdown]
# ## Two maps as one
#
# Two robots that know nothing of each other: each has a map in a frame of its own. `merge_maps` finds the one in
# the other and ties them by closures.

# %%
other = Run(simulate(LAB, seed=7)).complete().saved_map
assert other is not None
merged = merge_maps([saved, other]).saved
closures = closures_between_runs(merged)
print(f"{len(closures)} closures between the two runs")
print("squared residuals, median:", round(float(np.median([c.residual2 for c in closures])), 1))

# %% [markdown]
# A closure that turns out wrong can be taken out by hand, and a place erased; the graph is optimised anew.

# %%
wrong = closures[0]
edited = edit_map(merged, reject_closures=[(wrong.from_node, wrong.to_node)], erase=[(0.0, 0.5, 1.0, 1.5)])
moved_mm = 1e3 * np.hypot(*(edited.nodes - merged.nodes)[:, :2].T).max()
print(f"{edited.edits}; nodes moved by up to {moved_mm:.1f} mm")
