"""Faults that a user can mend: always one line, never a traceback."""

from __future__ import annotations


class MalippError(Exception):
    """A fault a person can act on; its text is one clear line.

    The command line prints the text on stderr and exits with status 2.
    """


class InputError(MalippError):
    """A file that is not what it should be.

    Parameters
    ----------
    source
        The file, as the user named it.
    line
        Line in the file, counted from 1; ``None`` where no line can be named.
    where
        Dotted path of the offending key (``team.robots[0].depots``); empty for the whole file.
    problem
        What is wrong and what would be right.
    """

    def __init__(self, source: str, line: int | None, where: str, problem: str) -> None:
        self.source, self.line, self.where, self.problem = source, line, where, problem
        place = source if line is None else f"{source}:{line}"
        super().__init__(f"{place}: {where}: {problem}" if where else f"{place}: {problem}")


class PlanError(MalippError):
    """A plan that breaks a rule of the paper, or a mission that cannot be planned as asked."""


class LinkError(MalippError):
    """A vehicle that did not answer, refused, or holds another mission than it was sent."""
