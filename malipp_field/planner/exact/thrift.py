"""The last stages over whole schedules: least energy, then least makespan, of a plan's samples.

`economy` lists every schedule that may be part of a plan with no more energy, `choices` picks one for each
robot. A choice is made into a plan, or refused where its robots would wait for each other in a circle; the
makespan of every choice of least energy is minimised over the arcs of these schedules (`chosen`). Where
schedules cannot be listed, the arc model takes over (`stages`), if it is allowed to.
"""

from __future__ import annotations

from malipp_field.planner.exact.choices import Choices
from malipp_field.planner.exact.chosen import cheapest_order, soonest_order
from malipp_field.planner.exact.economy import Economy
from malipp_field.planner.exact.realise import realise
from malipp_field.planner.exact.schedules import MOST_PLACES
from malipp_field.planner.exact.stages import energy_slack_j, least_energy, least_makespan
from malipp_field.planner.extract import TeamPlan
from malipp_field.planner.problem import Problem
from malipp_field.planner.progress import Search

_SAME = 1e-9
"""Relative difference of energy that is none."""
_ENERGY_SHARE = 0.7
"""Part of the time for the energy stage."""
_LISTING_SHARE = 0.5
"""Part of that for pricing, and of what is left for each list; the rest is the arc model's, if they fail."""
_FIRST_STEP, _STEP_GROWS = 0.01, 3.0
"""By how much more energy than the bound schedules are listed first, in units of the plan's, and then."""
_MOST_CHOICES = 40
"""Choices of least energy that are looked at for the makespan; with more the arc model takes over."""


def last_stages(
    problem: Problem, search: Search, best: TeamPlan, *, arcs: bool = True
) -> tuple[TeamPlan, bool]:
    """Return the plan of least energy with the same precision, and of these the soonest; and whether proven.

    The result is never worse than ``best``. Without ``arcs`` what cannot be settled over schedules is left as
    it is: for a large team the arc model takes seconds to be built alone.
    """
    energy_search = search.share(_ENERGY_SHARE)
    economy = _priced(problem, energy_search.share(_LISTING_SHARE), best)
    cheapest, energy_proven = best, False
    if economy is not None:
        cheapest, energy_proven = _cheapest(economy, energy_search, best)
    if not energy_proven and arcs:
        cheapest, energy_proven = least_energy(problem, energy_search, cheapest)
    elif economy is not None:
        cheapest, time_proven = _soonest(economy, search.share(_ENERGY_SHARE), cheapest)
        if time_proven:
            return cheapest, energy_proven
    if not arcs:
        return cheapest, False
    soonest, time_proven = least_makespan(problem, search, cheapest)
    return soonest, energy_proven and time_proven


def _priced(problem: Problem, search: Search, best: TeamPlan) -> Economy | None:
    """Return the master of a plan's samples at its linear optimum; None where it has none, or not in time."""
    if best.energy_j <= 0.0 or any(len(robot.places) > MOST_PLACES for robot in problem.robots):
        return None
    economy = Economy(problem, best)
    return economy if economy.price(search.effort) else None


def _most(economy: Economy, best: TeamPlan) -> float:
    """Return the most energy of a plan that counts as no more than the best, in the economy's unit."""
    return (best.energy_j + 2.0 * energy_slack_j(best)) / economy.unit_j


def _listed(economy: Economy, search: Search, most: float) -> Choices | None:
    """Return the choices of energy ``most`` or less; None where there are too many schedules."""
    pools = economy.pools(most, search.effort)
    if pools is None:
        return None
    choices = Choices(economy, pools)
    choices.tighten(most, search.effort)
    return choices


def _cheapest(economy: Economy, search: Search, best: TeamPlan) -> tuple[TeamPlan, bool]:
    """Return a plan of least energy, and whether that is proven.

    The less energy is allowed, the shorter are the lists: it is raised step by step until there is a plan.
    """
    step = _FIRST_STEP
    while economy.bound * economy.unit_j < best.energy_j * (1.0 - _SAME):
        most = min(economy.bound + step, _most(economy, best))
        choices = _listed(economy, search.share(_LISTING_SHARE), most)
        if choices is None:
            return best, False
        best, decided, found = _cheapest_of(choices, search, best, most)
        if found or not decided or most >= _most(economy, best):
            return best, decided
        step *= _STEP_GROWS
    return best, True


def _cheapest_of(
    choices: Choices, search: Search, best: TeamPlan, most: float
) -> tuple[TeamPlan, bool, bool]:
    """Return the best plan so far, whether all choices were looked at, and whether it is the cheapest."""
    economy = choices.economy
    while choices.bound < most:
        choice, none = choices.next(most, search.effort, search.seed)
        if choice is None:
            return best, none, False
        stated_j = choices.energy_j(choice)
        if stated_j >= best.energy_j * (1.0 - _SAME):
            return best, True, True
        team = realise(economy.problem, economy.robots, choice)
        if team is not None and team.energy_j <= stated_j * (1.0 + _SAME):
            return team, True, True
        team, decided = cheapest_order(economy, search, choice)  # the cheapest orders wait in a circle
        if not decided:
            return best, False, False
        choices.refuse(choice)
        if team is not None and team.energy_j < best.energy_j:
            best = team
    return best, True, False


def _soonest(economy: Economy, search: Search, best: TeamPlan) -> tuple[TeamPlan, bool]:
    """Return the soonest plan among those of least energy, and whether that is proven."""
    most = _most(economy, best)
    choices = _listed(economy, search.share(_LISTING_SHARE), most)
    for _ in range(0 if choices is None else _MOST_CHOICES):
        assert choices is not None
        choice, none = choices.next(most, search.effort, search.seed)
        if choice is None:
            return best, none
        best, decided = soonest_order(economy, search, choice, best)
        if not decided:
            return best, False
        choices.refuse(choice)
    return best, False
