"""What all parts share: SE(2), scans, results and events, errors, and configurations as plain values and TOML.

No state and no algorithm of a method belongs here: a part that only one other needs stands beside that one.
Imports nothing of this package, but for `RunResult.save`, which calls `saving` when it is called.
"""
