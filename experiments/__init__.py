"""Experiments: one script per table or figure, ``python -m experiments.NAME [--quick]``."""

import os

# one thread for each process, before numpy and numba start theirs: the sweeps run in parallel over processes
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"
