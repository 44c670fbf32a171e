"""Why a plan is as it is: what holds it back, what a little more would buy, and what its drops save.

Every figure comes from planning again with one thing changed, warm-started from the plan, each time with an
equal share of the time that is left. What "binds" is defined by that, not by what happens to be used up:

- more energy, room or sample slots *bind* if a plan with more of them is better than what is proven possible
  today;
- they are *slack* if planning with more is proven to end where the plan is, within the gap of the proof;
- else the question is *open*: a search ended before its proof.

Of plans that are not proven themselves the multipliers of the relaxation are given as well
(`relaxed_values`): they cost one cone program; large teams go without.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from functools import partial
from typing import Any, Protocol

from malipp_field.errors import PlanError
from malipp_field.mission import Mission, TeamState, initial_state
from malipp_field.plan import Plan
from malipp_field.planner.bounds.relaxation import RelaxedValue, relaxed_values
from malipp_field.planner.explanation import DropPlace, Explanation, Kind, Place, Resource, Trial, Verdict
from malipp_field.planner.solve import solve as plan_mission
from malipp_field.planner.usage import drops_by_node, left_out, usage

_ENERGY_STEPS = (0.10, 0.01, 0.05)
"""Shares of a budget tried: where the largest buys nothing, the others need not be asked."""
_LEAST_SHARE_S = 0.2
"""Where a question would get less time than this, questions about single robots are not asked."""
_RELAXATION_SHARE = 0.2
_RELAXATION_ALONE = 0.6
"""Where questions about single robots are not asked, the relaxation has all the more time."""
_ROUNDING = 1e-9


class Solver(Protocol):
    """`malipp_field.planner.solve.solve`, or a partial application of it."""

    def __call__(self, mission: Mission, **options: Any) -> Plan:
        """Plan a mission."""
        ...


def explain(
    mission: Mission,
    plan: Plan,
    *,
    state: TeamState | None = None,
    time_limit_s: float = 60.0,
    solve: Solver | None = None,
    on_progress: Callable[[str], None] = lambda _: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> Explanation:
    """Explain a plan by planning again with one thing changed at a time.

    Parameters
    ----------
    plan
        A plan of ``mission`` from ``state`` on, with routes.
    time_limit_s
        For all questions together; what was not asked by then is open.
    solve
        How to plan again: `solve` with method, gap, seed and so on filled in. By default as the plan was
        made ("miqp" by "exact", which finds the same).
    on_progress
        Told what is asked.
    cancelled
        Asked now and then; once true, what is known so far is returned.

    Raises
    ------
    PlanError
        Where the plan has no routes.
    """
    if not plan.robots or plan.objective is None:
        raise PlanError("there are no routes to explain")
    return _Inquiry(
        mission, plan, state or initial_state(mission), time_limit_s,
        solve or partial(plan_mission, **settings(plan)), on_progress, cancelled,
    ).run()  # fmt: skip


def settings(plan: Plan) -> dict[str, Any]:
    """Return the options of `solve` by which a plan is found again, from what it says of its method."""
    methods: dict[str, dict[str, Any]] = {
        "no-handoffs": {"method": "exact", "handoffs": False},
        "seq": {"method": "seq"},
        "arcs": {"method": "arcs"},
        "lns": {"method": "lns"},
        "fast": {"method": "fast"},
    }
    return methods.get(plan.method, {"method": "exact"})


class _Inquiry:
    """The questions about one plan, asked one after the other."""

    def __init__(
        self,
        mission: Mission,
        plan: Plan,
        state: TeamState,
        time_limit_s: float,
        solve: Solver,
        on_progress: Callable[[str], None],
        cancelled: Callable[[], bool],
    ) -> None:
        self.mission, self.state, self._plan, self._solve = mission, state, plan, solve
        self._on_progress, self._cancelled = on_progress, cancelled
        self._started = time.monotonic()
        self._deadline = self._started + time_limit_s
        self.proves = plan.bound.information is not None
        self._asked = 0
        self._drops = drops_by_node(plan)
        of_robots = len(plan.robots) * (len(_ENERGY_STEPS) + 2)
        self._left = self._questions = of_robots + self._of_drops + self.unproven
        self._each = time_limit_s / self._questions >= _LEAST_SHARE_S

    @property
    def _of_drops(self) -> int:
        """Number of questions about drops: one for each place, one for all of them."""
        return len(self._drops) + bool(self._drops)

    @property
    def unproven(self) -> bool:
        """Whether the plan may not be the best there is, although its method looks for that."""
        return self.proves and not self._sure(self._plan)

    def _sure(self, plan: Plan) -> bool:
        """Tell whether J of a plan is proven; its energy and makespan may be open."""
        return plan.status == "optimal" or (plan.gap is not None and plan.gap <= self.mission.planner.mip_gap)

    def run(self) -> Explanation:
        """Ask everything, as far as time allows."""
        first = self._plan
        relaxed = None if self._sure(first) else self._relaxed()
        if self.unproven:
            self._search_on()
        places, without = self._without_drops()
        resources = tuple(self._resources())
        return Explanation(
            information=_information(first),
            searched_j=_information(first) - _information(self._plan),
            proven=self._sure(self._plan),
            gap=self._plan.gap,
            sample_mass_kg=self.mission.team.sample_mass_kg,
            resources=resources,
            without_drops=without,
            places=places,
            relaxed=relaxed,
            asked=self._asked,
            time_s=time.monotonic() - self._started,
        )

    def _search_on(self) -> None:
        """Plan again with nothing changed: what that finds must not be put down to a change."""
        again = self._ask("the same again, as long as each of the questions", self.mission, self.state)
        if again is None or not (_information(again) < _information(self._plan) or self._sure(again)):
            return
        before = self._of_drops
        self._plan, self._drops = again, drops_by_node(again)
        self._left += self._of_drops - before
        self._questions += self._of_drops - before

    def _relaxed(self) -> dict[str, RelaxedValue] | None:
        self._on_progress("the relaxation's multipliers")
        share = _RELAXATION_SHARE if self._each else _RELAXATION_ALONE
        return relaxed_values(self.mission, self.state, share * self._time_left_s)

    @property
    def _time_left_s(self) -> float:
        return max(0.0, self._deadline - time.monotonic())

    def _ask(self, what: str, mission: Mission, state: TeamState, **options: Any) -> Plan | None:
        """Plan again with an equal share of the time left; None where no time is left, or no plan found."""
        share = self._time_left_s / max(self._left, 1)
        self._left -= 1
        if share <= 0.0 or self._cancelled():
            return None
        self._asked += 1
        self._on_progress(f"{what} ({self._questions - self._left} of at most {self._questions})")
        found = self._solve(
            mission,
            **{"state": state, "time_limit_s": share, "warm_start": self._plan, "cancelled": self._cancelled}
            | options,
        )
        return found if found.robots else None

    # more of something

    def _resources(self) -> list[Resource]:
        found = []
        for robot in self.mission.team.robots:
            for use in usage(self.mission, self._plan, self.state, robot.id):
                trial = self._more(robot.id, use.kind) if self._each else None
                found.append(Resource(use, trial, self._verdict(trial)))
        return found

    def _more(self, robot_id: str, kind: Kind) -> Trial | None:
        if kind == "energy":
            return self._more_energy(robot_id)
        robot = self.mission.robot(robot_id)
        key = {"room": "payload_capacity", "slots": "samples_per_node"}[kind]
        richer = _with_robot(self.mission, robot_id, {key: getattr(robot, key) + 1})
        what = "room for one more sample" if kind == "room" else "one more sample at a node"
        return self._trial(1.0, self._ask(f"{robot_id} with {what}", richer, self.state))

    def _more_energy(self, robot_id: str) -> Trial | None:
        """Return the trial with the smallest of the steps that lowers J, else with the largest."""
        budget_j, largest = self.mission.robot(robot_id).energy_budget_j, None
        for k, share in enumerate(_ENERGY_STEPS):
            step_j = share * max(budget_j, 1.0)
            what = f"{robot_id} with {100 * share:.0f} % more energy"
            trial = self._trial(
                step_j, self._ask(what, self.mission, _with_energy(self.state, robot_id, step_j))
            )
            largest = trial if k == 0 else largest
            helps = trial is not None and trial.fall > self._noise
            if (k == 0) != helps:  # the largest buys nothing, or a smaller one buys something
                self._left -= len(_ENERGY_STEPS) - 1 - k
                return trial
        return largest

    def _trial(self, step: float, found: Plan | None) -> Trial | None:
        if found is None or found.objective is None or self._plan.objective is None:
            return None
        now, bound = _information(self._plan), found.bound.information
        return Trial(
            step=step,
            fall=now - found.objective.information,
            most=None if bound is None else now - bound,
            proven=self._sure(found),
            energy_j=found.objective.energy_j - self._plan.objective.energy_j,
        )

    @property
    def _noise(self) -> float:
        """Fall in J that means nothing: what the plan could fall by as things are, where that is proven."""
        now, bound = _information(self._plan), self._plan.bound.information
        known = now if bound is None or not self._sure(self._plan) else bound
        return now - known + _ROUNDING * max(1.0, now)

    def _verdict(self, trial: Trial | None) -> Verdict:
        if trial is None or not self._sure(self._plan):
            return "open"
        if trial.fall > self._noise:
            return "binds"
        return "slack" if trial.proven else "open"

    # less of something

    def _without_drops(self) -> tuple[tuple[DropPlace, ...], Trial | None]:
        """Ask what the plan would lose without its drops, all of them and place by place."""
        if not self._drops:
            return (), None
        places = []
        start = self._left_out(self._drops)
        none = self._ask("no drops at all", self.mission, self.state, handoffs=False, warm_start=start)
        for node, drops in self._drops.items():
            # The plan itself cannot be the start of a search in which its drops are forbidden.
            rest = self._left_out([node])
            found = self._ask(
                f"no drops at {node}", self.mission, self.state, closed={node}, warm_start=rest or none
            )
            rise = None if rest is None else _information(rest) - _information(self._plan)
            places.append(DropPlace(Place(node, drops, rise), self._trial(0.0, found)))
        return tuple(places), self._trial(0.0, none)

    def _left_out(self, nodes: Collection[str]) -> Plan | None:
        return left_out(self.mission, self._plan, self.state, nodes)


def _information(plan: Plan) -> float:
    assert plan.objective is not None
    return plan.objective.information


def _with_robot(mission: Mission, robot_id: str, changes: dict[str, object]) -> Mission:
    robots = tuple(
        robot.model_copy(update=changes) if robot.id == robot_id else robot for robot in mission.team.robots
    )
    return mission.model_copy(update={"team": mission.team.model_copy(update={"robots": robots})})


def _with_energy(state: TeamState, robot_id: str, more_j: float) -> TeamState:
    robots = tuple(
        robot.model_copy(update={"energy_left_j": robot.energy_left_j + more_j})
        if robot.id == robot_id
        else robot
        for robot in state.robots
    )
    return state.model_copy(update={"robots": robots})
