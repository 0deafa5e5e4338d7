"""Recordings for the rerun viewer, of a run and of several side by side: the only importers of rerun.

A recording observes a run and never changes it: what it shows is handed to it.
Imports `core`, `evaluation`, `observer` and `viz`, and of `detection` the reasons' names.
"""
