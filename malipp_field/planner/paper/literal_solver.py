"""Mixed-integer quadratic solvers by way of cvxpy: which are recognised, how they are run, what they prove.

SCIP (PySCIPOpt) takes no quadratic objective: cvxpy hands it one second-order cone for each sum of squares,
with the objective linear in their heights. SCIP's tolerance for these is absolute (1e-6), which is why the
model states J in units of the prior variance and has one sum of squares a test point: J comes out right to
about a millionth of the prior.

cvxpy's own interface to SCIP cannot be asked to stop, forgets the dual bound where there is no solution, and
takes no starting point; `Scip` adds these three.

SCIP searches one tree on one thread, whatever number of threads is allowed, and hears of a cancellation when
it has solved its present linear program. Other solvers keep the time limit by themselves and hear of none.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import cvxpy as cp
import numpy as np
from cvxpy.reductions.solvers.conic_solvers.scip_conif import SCIP

from malipp_field.errors import PlanError
from malipp_field.planner.linear import Effort

try:
    import pyscipopt
except ModuleNotFoundError:  # optional: any other recognised solver will do
    pyscipopt = None

_ABSOLUTE_GAP = 1e-10
_REPORT_S = 0.5


@dataclass(frozen=True)
class Run:
    """How one stage is to be run; ``watch`` is told incumbent, bound (None where unknown) and nodes."""

    effort: Effort
    gap: float
    seed: int
    threads: int | None
    watch: Callable[[float | None, float | None, int], None]


@dataclass(frozen=True)
class Ending:
    """How a run ended: ``status`` is "optimal", "infeasible" or "stopped".

    ``bound`` is proven for the objective; -inf where the solver does not say. ``found`` tells whether the
    variables hold a feasible point.
    """

    status: str
    bound: float
    found: bool


def _options(run: Run) -> dict[str, dict[str, Any]]:
    """Return the options of every solver that is recognised besides SCIP, in its own names."""
    left_s, threads, seed = run.effort.left_s, run.threads or 0, run.seed % 2**31
    return {
        "GUROBI": {"TimeLimit": left_s, "MIPGap": run.gap, "Threads": threads, "Seed": seed},
        "CPLEX": {
            "cplex_params": {
                "timelimit": left_s,
                "mip.tolerances.mipgap": run.gap,
                "threads": threads,
                "randomseed": seed,
            }
        },
        "XPRESS": {
            "timelimit": left_s, "miprelstop": run.gap, "threads": threads or -1, "randomseed": seed
        },
        "COPT": {"TimeLimit": left_s, "RelGap": run.gap, "Threads": threads or -1},
        "MOSEK": {
            "mosek_params": {
                "MSK_DPAR_OPTIMIZER_MAX_TIME": left_s,
                "MSK_DPAR_MIO_TOL_REL_GAP": run.gap,
                "MSK_IPAR_NUM_THREADS": threads,
                "MSK_IPAR_MIO_SEED": seed,
            }
        },
    }  # fmt: skip


RECOGNISED = ("SCIP", "GUROBI", "CPLEX", "XPRESS", "COPT", "MOSEK")
"""Solvers that cvxpy can hand mixed-integer second-order cones or quadratic objectives, first choice first.

Left out are ECOS_BB, which is known to miss optima, and KNITRO, which is made for local solutions.
"""


def choose_solver() -> str:
    """Return the first recognised solver that is installed.

    Raises
    ------
    PlanError
        Where there is none.
    """
    installed = set(cp.installed_solvers())
    for name in RECOGNISED:
        if name in installed:
            return name
    raise PlanError(
        "method miqp needs a mixed-integer quadratic solver that cvxpy can find: install pyscipopt (SCIP), "
        f"or one of {', '.join(RECOGNISED[1:])}"
    )


def minimise(objective: Any, constraints: list[Any], run: Run, start: list[Any]) -> Ending:
    """Minimise a cvxpy expression; leave the best point found in the variables' values.

    Parameters
    ----------
    start
        Variables whose present values are offered to the solver as a feasible point; none where empty. Only
        SCIP takes them.
    """
    if run.effort.over:
        return Ending("stopped", -np.inf, found=False)
    problem = cp.Problem(cp.Minimize(objective), constraints)
    name = choose_solver()
    interface = Scip(run, start) if name == "SCIP" else None
    data, chain, inverse = problem.get_problem_data(interface or name)
    raw = chain.solve_via_data(problem, data, solver_opts={} if interface else _options(run)[name])
    solution = chain.invert(raw, inverse)
    found = solution.status in cp.settings.SOLUTION_PRESENT
    if found:
        problem.unpack(solution)
    return interface.ending if interface else _ending(solution, found, run.gap)


def _ending(solution: Any, found: bool, gap: float) -> Ending:
    """Read a solver whose interface gives no bound: what it calls optimal is so to within the gap."""
    if solution.status == cp.OPTIMAL:
        return Ending("optimal", solution.opt_val - gap * abs(solution.opt_val), found=True)
    impossible = {cp.INFEASIBLE, cp.settings.INFEASIBLE_OR_UNBOUNDED}  # no objective here is unbounded
    return Ending("infeasible" if solution.status in impossible else "stopped", -np.inf, found)


class Scip(SCIP):  # type: ignore[misc]  # cvxpy has no types
    """cvxpy's interface to SCIP, with a deadline, cancellation, a starting point and the proven bound."""

    def __init__(self, run: Run, start: list[Any]) -> None:
        super().__init__()
        self._run, self._start = run, start
        self.ending = Ending("stopped", -np.inf, found=False)

    def name(self) -> str:
        """Return a name that is not cvxpy's own."""
        return "MALIPP_SCIP"

    def _solve(
        self, model: Any, variables: list[Any], constraints: list[Any], data: Mapping[str, Any], dims: Any
    ) -> dict[str, Any]:
        run = self._run
        model.setParams(
            {
                "limits/time": run.effort.left_s,
                "limits/gap": run.gap,
                "limits/absgap": _ABSOLUTE_GAP,
                "randomization/randomseedshift": run.seed % 2**31,
                "misc/catchctrlc": False,  # Ctrl-C is the caller's to hear
            }
        )
        self._offer(model, variables, data)
        _listen(model, run)
        solution: dict[str, Any] = super()._solve(model, variables, constraints, data, dims)
        status, found = model.getStatus(), model.getNSols() > 0
        if status in {"infeasible", "inforunbd"}:  # no objective here is unbounded
            self.ending = Ending("infeasible", np.inf, found=False)
        else:
            proven = status in {"optimal", "gaplimit"}
            self.ending = Ending("optimal" if proven else "stopped", model.getDualbound(), found)
        solution["status"] = cp.OPTIMAL if found else cp.settings.SOLVER_ERROR
        solution.setdefault("value", np.nan)
        return solution

    def _offer(self, model: Any, variables: list[Any], data: Mapping[str, Any]) -> None:
        """Give the starting point to SCIP, which completes it by what cvxpy has added: the cones."""
        if not self._start:
            return
        columns = data[cp.settings.PARAM_PROB].var_id_to_col
        point = model.createPartialSol()
        for variable in self._start:
            first = columns.get(variable.id)
            for i, value in enumerate(variable.value.flatten(order="F") if first is not None else ()):
                model.setSolVal(point, variables[first + i], float(value))
        model.addSol(point)


def _listen(model: Any, run: Run) -> None:
    """Have SCIP report and stop when it is time."""
    kinds = pyscipopt.SCIP_EVENTTYPE
    rounds = (kinds.PRESOLVEROUND, kinds.ROWADDEDSEPA)  # what happens while the root is still worked on
    events = (kinds.NODESOLVED, kinds.LPSOLVED, kinds.BESTSOLFOUND, *rounds)

    class Listener(pyscipopt.Eventhdlr):  # type: ignore[misc]  # PySCIPOpt's types are not followed
        told = 0.0

        def eventinit(self) -> None:
            for event in events:
                self.model.catchEvent(event, self)

        def eventexit(self) -> None:
            for event in events:
                self.model.dropEvent(event, self)

        def eventexec(self, event: Any) -> None:
            if run.effort.over:
                self.model.interruptSolve()
            now = time.monotonic()
            if now - self.told > _REPORT_S or event.getType() == kinds.BESTSOLFOUND:
                self.told = now
                incumbent, bound = self.model.getPrimalbound(), self.model.getDualbound()
                known = incumbent < self.model.infinity()  # a start not yet completed counts as a solution
                run.watch(incumbent if known else None, bound, self.model.getNNodes())

    model.includeEventhdlr(Listener(), "malipp", "reports, and stops when it is time")
