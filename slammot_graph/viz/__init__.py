"""Pictures of a run: overview, animation, and the colors that all pictures share; recordings are in `viz.rerun`.

Each drawing takes results, not the parts that made them, and writes one file.
Imports `core` and `logs`, and `observer` for what is drawn while a run goes on.
"""
