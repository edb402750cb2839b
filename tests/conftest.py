"""What all tests share."""

from __future__ import annotations

import os

# One BLAS thread: results do not hang on the machine, and tests running side by side do not starve.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"
