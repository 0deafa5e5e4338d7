"""Recordings for the rerun viewer: of one run (`run`, an `Observer`) and of several (`comparison`).

The only importers of rerun, and only when something is recorded; may import `core`, `observer`, `viz` and `run_folder`.
`run` keeps the steps and hands them to a panel per topic, each of which has its own state; `layout` says how it looks.
"""
