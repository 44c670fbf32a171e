"""The mission in figures: what was planned, what came of it, and where every sample went."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from malipp_field.bus.messages import Confirmation, PlanAdopted, SampleRecord
from malipp_field.field import candidate_ids, information_model
from malipp_field.mission import Robot
from malipp_field.record import Run
from malipp_field.review.prediction import adoption_time, energy_used, predicted_energy
from malipp_field.review.tracks import driven_m, local_track
from malipp_field.vehicle.steps import Action


@dataclass(frozen=True)
class InformationSummary:
    """The objective J (weighted posterior variance at the test points; less is better)."""

    prior: float
    """With no sample at all."""
    planned: float | None
    """Of plan version 1; null where no plan was adopted."""
    last_planned: float | None
    """Of the last version, what was collected before it included."""
    achieved: float
    """Of the samples whose collection was confirmed, with the precision of the sensors that took them."""


@dataclass(frozen=True)
class RobotSummary:
    """One robot, planned (by version 1) against measured."""

    robot: str
    energy_budget_j: float
    energy_planned_j: float | None
    energy_expected_j: float | None
    """By the last plan: what was measured when it came into force, and its prediction from there on."""
    energy_used_j: float | None
    """Null where no telemetry was recorded."""
    time_planned_s: float | None
    time_taken_s: float | None
    """Mission time at which the vehicle had finished for good; null where it had not."""
    distance_m: float
    collected: int
    delivered: int


@dataclass(frozen=True)
class Replan:
    """A plan version after the first."""

    version: int
    time_s: float
    """Mission time."""
    reason: str
    information: float | None
    vehicles: tuple[str, ...]
    """Those that got a new mission."""


@dataclass(frozen=True)
class Hand:
    """One link of a chain of custody, in mission time."""

    time_s: float
    action: Action
    robot: str
    node: str


@dataclass(frozen=True)
class SampleSummary:
    """One container that was filled: its origin, and every hand it went through."""

    tag: int
    node: str
    sampler: str
    value: float | None
    hands: tuple[Hand, ...]
    """The first is the collection."""
    state: str
    holder: str | None
    """The robot that carries it, or the node where it lies or was delivered."""

    @property
    def taken_s(self) -> float:
        """Mission time of the collection."""
        return self.hands[0].time_s

    @property
    def delivered_s(self) -> float | None:
        """Mission time of the delivery; null for one that is not home."""
        return self.hands[-1].time_s if self.state == "delivered" else None


@dataclass(frozen=True)
class Summary:
    """All figures of one mission; times in seconds of mission time, energies in joules."""

    mission: str
    source: str
    complete: bool
    """False for a recording that was cut off: the figures then end where it does."""
    start_s: float
    """Mission time 0, in seconds since the Unix epoch."""
    duration_s: float
    """Mission time of the last message."""
    information: InformationSummary
    robots: tuple[RobotSummary, ...]
    replans: tuple[Replan, ...]
    samples: tuple[SampleSummary, ...]
    """By tag, those that were taken."""

    @property
    def delivered(self) -> int:
        """Samples that came home."""
        return sum(sample.state == "delivered" for sample in self.samples)


def summarise(run: Run) -> Summary:
    """Return the figures of a recorded mission, from the recording alone."""
    records = run.ledgers[-1].samples if run.ledgers else ()
    return Summary(
        mission=run.mission.name,
        source=run.source,
        complete=run.complete,
        start_s=run.start_s,
        duration_s=run.end_s - run.start_s,
        information=_information(run),
        robots=tuple(_robot(run, robot) for robot in run.mission.team.robots),
        replans=tuple(_replan(run, adopted) for adopted in run.plans[1:]),
        samples=tuple(
            _sample(run, record) for record in sorted(records, key=lambda r: r.sample.tag) if record.history
        ),
    )


def done(run: Run, action: Action, robot: str | None = None) -> list[Confirmation]:
    """Return the confirmations of actions of one kind that succeeded, one a container and place."""
    found = {
        (said.robot, said.node, said.tag): said
        for said in run.confirmations
        if said.ok and said.action is action and robot in (None, said.robot)
    }
    return list(found.values())


def information_over_time(run: Run) -> list[tuple[float, float]]:
    """Return (seconds since the Unix epoch, J): the prior at the start, then J after each sample."""
    model = information_model(run.mission)
    index = {node: position for position, node in enumerate(candidate_ids(run.mission))}
    precision = np.zeros(len(index))
    course = [(run.start_s, model.prior)]
    for said in done(run, Action.COLLECT):
        precision[index[said.node]] += 1.0 / run.mission.robot(said.robot).noise_variance
        course.append((said.time_s, model.value(precision)))
    return course


def _information(run: Run) -> InformationSummary:
    course = information_over_time(run)
    planned = [_planned_information(adopted) for adopted in run.plans]
    return InformationSummary(
        prior=course[0][1],
        planned=planned[0] if planned else None,
        last_planned=planned[-1] if planned else None,
        achieved=course[-1][1],
    )


def _planned_information(adopted: PlanAdopted) -> float | None:
    return None if adopted.plan.objective is None else adopted.plan.objective.information


def _robot(run: Run, robot: Robot) -> RobotSummary:
    times, used = energy_used(run, robot.id)
    curves = predicted_energy(run, robot.id)
    _, track = local_track(run, robot.id)
    return RobotSummary(
        robot=robot.id,
        energy_budget_j=robot.energy_budget_j,
        energy_planned_j=float(curves[0][1][-1]) if curves else None,
        energy_expected_j=float(curves[-1][1][-1]) if curves else None,
        energy_used_j=float(used[-1]) if times.size else None,
        time_planned_s=run.plans[0].plan.robot(robot.id).route[-1].depart_s if run.plans else None,
        time_taken_s=_finished_s(run, robot.id),
        distance_m=driven_m(track),
        collected=len(done(run, Action.COLLECT, robot.id)),
        delivered=len(done(run, Action.UNLOAD, robot.id)),
    )


def _finished_s(run: Run, robot: str) -> float | None:
    """Return the mission time from which every report says finished; a replan may end an earlier rest."""
    since: float | None = None
    for report in run.telemetry[robot]:
        if not report.finished:
            since = None
        elif since is None:
            since = max(0.0, report.time_s - run.start_s)
    return since


def _replan(run: Run, adopted: PlanAdopted) -> Replan:
    return Replan(
        version=adopted.plan.version,
        time_s=adoption_time(run, adopted),
        reason=adopted.reason,
        information=_planned_information(adopted),
        vehicles=tuple(order.robot for order in adopted.missions if order.version == adopted.plan.version),
    )


def _sample(run: Run, record: SampleRecord) -> SampleSummary:
    return SampleSummary(
        tag=record.sample.tag,
        node=record.sample.node,
        sampler=record.sample.sampler,
        value=record.value,
        hands=tuple(
            Hand(time_s=event.time_s - run.start_s, action=event.action, robot=event.robot, node=event.node)
            for event in record.history
        ),
        state=record.state,
        holder=record.holder,
    )
