"""What the commands exit with, beside 0 for success; README.md has the table."""

INPUT_ERROR = 2
INFEASIBLE = 3
LIMIT_REACHED = 4
INCOMPLETE = 5
NOT_DONE = 6
UNKNOWN = 7
INTERRUPTED = 130
