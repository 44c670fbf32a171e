"""Mission planning, telemetry and review for teams of sampling rovers.

The way of the data is drawn in ``docs/architecture.md``; every sub-package is one room of that house.
"""

__version__ = "0.1.0"
