"""Mission planning, telemetry and review for teams of sampling rovers.

The way of the data is drawn in ``docs/architecture.md``; every sub-package is one room of that house.
"""

import os

# Matrices here are small: BLAS on several threads takes longer, above all beside the planner's own threads.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

__version__ = "0.1.0"
