"""Pictures of runs: the overview, moving pictures, and in `rerun` the recordings; one palette for all of them.

May import `core`, and `observer` for the recording of a run; computes nothing that a run does not hand out.
"""
