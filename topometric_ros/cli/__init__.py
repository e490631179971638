"""The `topometric` command."""

import os

# Our matrices are small: threads of BLAS' own, waiting for each other, doubled the CPU time of a
# merge. It reads this once, when numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
