"""From the plan in force to a plan for what is left of a mission: where replanning begins.

What happened since may have broken the plan in force: less energy, a robot lost, a drop that is not there.
What still stands of it is kept. Samples on board or lying in drops must come home, by a new way if need be;
samples not yet taken may be left out. The order of the attempts is that of their cost:

1. the plan as it is, followed stop by stop as far as the new state allows (`followed`);
2. robots that overdraw a budget or a capacity leave out what they can best do without, and samples without a
   way home are put in anew by the compiled search (`Kernel.begin`), where that fails with ever less of the
   old plan left, down to direct routes with only what must come home;
3. the arc model with nobody sampling, first without handoffs: a plan, or the proof that there is none.
"""

from __future__ import annotations

import math
import random
from collections import Counter
from dataclasses import replace

from malipp_field.plan import Plan
from malipp_field.planner.draft import COLLECTED, ON_BOARD, Draft, Sample, handlers
from malipp_field.planner.exact.stages import plan_of_precision
from malipp_field.planner.extract import TeamPlan, team_plan
from malipp_field.planner.follow import followed
from malipp_field.planner.problem import Problem, within
from malipp_field.planner.progress import Result, Search
from malipp_field.planner.search.improver import Improver
from malipp_field.planner.search.kernel import Kernel
from malipp_field.planner.search.state import LEAST_HOPS, case_of, load, most_samples, unloaded

_ATTEMPTS = 60
"""Attempts to bring home what has no way home, the last of them with nothing left of the old plan."""
_SMALL_J = 1e-9
"""What leaving a sample out is taken to save at least."""


def first_plan(problem: Problem, advice: Plan | None, search: Search) -> Result:
    """Return a plan to begin with that is no worse than ``advice``, should that still keep every rule.

    Parameters
    ----------
    advice
        The plan in force from the problem's state on; names that the mission does not have are passed over.
    search
        Its effort limits the arc model only; the seed is that of all attempts.

    Returns
    -------
    Result
        Without a plan where the time was too short to find one, or ``infeasible`` by proof.
    """
    if advice is None:
        team = Improver(problem, search.seed).construct()
    else:
        team = repaired(problem, advice, search.seed)
    if team is not None:
        return Result(team, 0.0, proven=False)
    return settled(problem, search)


def repaired(problem: Problem, advice: Plan, seed: int) -> TeamPlan | None:
    """Return a plan that keeps what still stands of ``advice``; None where no attempt finds one."""
    whole, homeless = followed(problem, advice)
    worth = _worth(problem, whole)
    for r in range(len(problem.robots)):
        whole, more = _relieve(whole, r, worth)
        homeless += more
    hops = max((len(sample.hops) for sample in whole.samples), default=0)
    case, rng = case_of(problem), random.Random(seed)  # noqa: S311 (a search, not a secret)
    kernel = Kernel(case, most_samples(problem, case), max(hops, LEAST_HOPS), rng.getrandbits(64))
    for attempt in range(_ATTEMPTS):
        share = attempt / (_ATTEMPTS - 1)
        freed = {r for r in range(len(problem.robots)) if attempt and rng.random() <= share}
        rest, more = _without(whole, freed)
        team = _brought_home(kernel, rest, homeless + more)
        if team is not None:
            return team
    return None


def _brought_home(kernel: Kernel, draft: Draft, homeless: list[Sample]) -> TeamPlan | None:
    """Return the draft with the homeless put in, as a plan; None where that breaks a rule."""
    load(kernel.best, draft)
    for row, sample in zip(kernel.scratch.homeless, homeless, strict=False):
        row[:] = sample.kind, sample.node, sample.robot, sample.stock
    if not kernel.begin(len(homeless)):
        return None
    return team_plan(draft.problem, unloaded(draft.problem, kernel.best).visits())


def _without(whole: Draft, freed: set[int]) -> tuple[Draft, list[Sample]]:
    """Return a draft without what the robots ``freed`` handle, and what of that must come home."""
    going = [sample for sample in whole.samples if not freed.isdisjoint(handlers(sample))]
    draft = _copy(whole, [sample for sample in whole.samples if freed.isdisjoint(handlers(sample))])
    draft.tidy()
    return draft, _to_be_brought(going)


def _copy(draft: Draft, samples: list[Sample]) -> Draft:
    """Return a draft with the same routes and other samples."""
    return Draft(draft.problem, [list(route) for route in draft.routes], list(samples))


def _relieve(draft: Draft, r: int, worth: dict[tuple[int, int], float]) -> tuple[Draft, list[Sample]]:
    """Leave samples out until a robot keeps its rules; return what is left, and what must still come home.

    Samples not yet taken go first, those first that tell least for the energy they take.
    """
    homeless = []
    while not _is_kept(draft, r):
        energy_j, options = _energy_j(draft, r), []
        for sample in {s for s in draft.samples if r in handlers(s)}:
            trial = _copy(draft, draft.samples)
            trial.remove(sample)
            trial.tidy()
            trial_j = _energy_j(trial, r)
            saved_j = max(energy_j - trial_j, 0.0) if trial_j < math.inf else 0.0
            told = worth.get((sample.robot, sample.node), 0.0) if sample.kind == COLLECTED else 0.0
            options.append((sample.kind != COLLECTED, told / (saved_j + _SMALL_J), sample, trial))
        if not options:  # it cannot even drive home: nothing that is left out helps
            break
        _, _, sample, draft = min(options, key=lambda option: option[:3])
        homeless += _to_be_brought([sample])
    return draft, homeless


def _is_kept(draft: Draft, r: int) -> bool:
    """Tell whether a robot keeps its budget, and never holds more than it can carry."""
    robot = draft.problem.robots[r]
    return max(_loads(draft, r)) <= robot.capacity and within(_energy_j(draft, r), robot.budget_j)


def _energy_j(draft: Draft, r: int) -> float:
    """Return the energy of a robot's route."""
    robot, kg = draft.problem.robots[r], draft.problem.sample_mass_kg
    rows, route = robot.closure.rows, draft.routes[r]
    loads = _loads(draft, r)[1::2]
    return sum(
        rows[u][v] * (robot.empty_mass_kg + kg * carried)
        for u, v, carried in zip(route, route[1:], loads, strict=False)
    )


def _loads(draft: Draft, r: int) -> list[int]:
    """Return the samples held at each stop before anything is handed over, and on departure, in turns."""
    robot, found = draft.problem.robots[r], []
    carried = sum(sample.kind == ON_BOARD and sample.robot == r for sample in draft.samples)
    for node in draft.routes[r][:-1]:
        held = carried + draft.collect[r][node]
        given = draft.give[r][node]
        if node in robot.depots:  # all that is not handed over is unloaded
            held, carried = held - given, draft.take[r][node]
        else:
            carried = held - given + draft.take[r][node]
        found += [held, carried]
    return found


def _worth(problem: Problem, draft: Draft) -> dict[tuple[int, int], float]:
    """Return by how much J falls, about, by one sample of each robot at each candidate it samples."""
    precision, position = problem.gained.copy(), {v: i for i, v in enumerate(problem.candidates)}
    taken = Counter((s.robot, s.node) for s in draft.samples if s.kind == COLLECTED)
    for (r, node), count in taken.items():
        precision[position[node]] += count * problem.robots[r].precision
    _, slope = problem.information.value_and_gradient(precision)
    return {(r, node): -float(slope[position[node]]) * problem.robots[r].precision for r, node in taken}


def _to_be_brought(samples: list[Sample]) -> list[Sample]:
    """Return those that must come home, with no way chosen; what lies in a drop is anybody's."""
    return [
        sample._replace(hops=(), robot=sample.robot if sample.kind == ON_BOARD else 0)
        for sample in samples
        if sample.kind != COLLECTED
    ]


def settled(problem: Problem, search: Search) -> Result:
    """Return a plan in which nobody samples, or the proof that there is none."""
    for asked in (replace(problem, handoffs=False), problem) if problem.handoffs else (problem,):
        team, impossible = plan_of_precision(asked, search, problem.gained)
        if team is not None:
            return Result(team, 0.0, proven=False)
    return Result(None, 0.0, proven=False, infeasible=impossible)
