"""How a benchmark script ends, well or not."""

from __future__ import annotations

import sys
from collections.abc import Callable

from malipp_field.errors import MalippError


def ended(main: Callable[[], int]) -> int:
    """Run a script and return its exit code: 2 for a user's error, told in one line, and 130 for Ctrl-C."""
    try:
        return main()
    except KeyboardInterrupt:
        print("\nstopped; the same command goes on from here", file=sys.stderr)
        return 130
    except MalippError as fault:
        print(fault, file=sys.stderr)
        return 2
