"""An explanation of a plan as tables and words for a person who plans in the field."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import Console, RenderableType
from rich.table import Table

from malipp_field.planner.explanation import DropPlace, Explanation, Resource, Trial, Usage, Verdict

_WIDTH = 100
"""Columns where the output is no terminal and has no width of its own."""
_VERDICTS: dict[Verdict, str] = {"binds": "yes", "slack": "no", "open": "open"}
_NAMES = {"energy": "energy", "room": "room for samples", "slots": "samples at a node"}


def print_explanation(explanation: Explanation, console: Console) -> None:
    """Print an explanation; as wide as a page where the console is no terminal."""
    if not console.is_terminal:
        console = Console(file=console.file, width=_WIDTH, highlight=False)
    for part in explanation_view(explanation):
        console.print(part)


def explanation_view(explanation: Explanation) -> Iterator[RenderableType]:
    """Return what is to be printed, part by part."""
    yield "\n[bold]Why the plan is as it is[/bold]"
    yield _standing(explanation)
    yield "\n[bold]What more of something would buy[/bold]"
    yield (
        "Energy a robot may use, samples it can carry, samples it may take at each node; in brackets, shares "
        "of J."
    )
    yield _resource_table(explanation)
    yield _summary(explanation)
    if explanation.places:
        yield "\n[bold]What the drops save[/bold]"
        yield _drop_table(explanation)
        yield _drop_words()
    if explanation.relaxed is not None:
        yield _relaxed_words()


def _standing(explanation: Explanation) -> str:
    """Return how sure the figures are."""
    repeated = f"The mission was planned {explanation.asked} times more ({explanation.time_s:.0f} s)"
    if explanation.proven:
        gap = 100.0 * (explanation.gap or 0.0)
        return (
            f"J, the prediction error that is left, is {explanation.information:.4f}: proven to be the least "
            f"possible (gap {gap:.2f} %). {repeated}, each time with one thing changed; the figures are the "
            "changes of J."
        )
    words = (
        f"J, the prediction error that is left, is {explanation.information:.4f}, not proven to be the least "
        f"possible. {repeated}, each time with one thing changed. Where the search ended before its "
        "proof, a longer one may change the figures."
    )
    if explanation.searched_j > 0.0:
        words += (
            f" Searching again with nothing changed lowered J by {explanation.searched_j:.4f}: plan with a "
            "longer time limit. The figures compare with that better plan."
        )
    return words


def _resource_table(explanation: Explanation) -> Table:
    table = Table(box=None, pad_edge=False)
    for heading in ("robot", "has", "uses", "scarce", "with", "J falls by", "worth"):
        table.add_column(heading)
    if explanation.relaxed is not None:
        table.add_column("relaxed")
    before = ""
    for resource in explanation.resources:
        robot = resource.use.robot
        row = [
            "" if robot == before else robot,
            _has(resource.use),
            _uses(resource.use),
            _VERDICTS[resource.verdict],
            _more(resource),
            _fall(resource, explanation.information),
            _worth(resource, explanation.sample_mass_kg),
        ]
        if explanation.relaxed is not None:
            row.append(_relaxed(resource, explanation))
        table.add_row(*row)
        before = robot
    return table


def _has(use: Usage) -> str:
    if use.kind == "energy":
        return energy_words(use.has)
    if use.kind == "room":
        return f"{use.has:.0f} on board"
    return f"{use.has:.0f} per node"


def _uses(use: Usage) -> str:
    if use.kind == "energy":
        return energy_words(use.uses)
    if use.kind == "room":
        return f"{use.uses:.0f} at most"
    return f"all at {use.at_limit} of {use.nodes}" if use.nodes else "none"


def _more(resource: Resource) -> str:
    """Return what the mission was planned again with."""
    if resource.trial is None:
        return "-"
    if resource.use.kind == "energy":
        return f"+{energy_words(resource.trial.step)}"
    return "+1 on board" if resource.use.kind == "room" else "+1 per node"


def _fall(resource: Resource, information: float) -> str:
    trial = resource.trial
    if trial is None:
        return "not asked"
    figure = f"{trial.fall:.4f} ({_percent(trial.fall, information)})"
    if resource.verdict == "binds":
        return figure if trial.proven else f"at least {figure}"
    if resource.verdict == "slack":
        return "nothing" if trial.energy_j >= -0.05 else f"nothing; saves {energy_words(-trial.energy_j)}"
    return figure if trial.fall > 1e-6 * information else "none found"


def _worth(resource: Resource, sample_mass_kg: float) -> str:
    """Return the fall of J per unit."""
    trial, value = resource.trial, resource.value
    if trial is None or value is None or resource.verdict == "slack" or trial.fall <= 0.0:
        return "-"
    if resource.use.kind == "energy":
        return f"{1000.0 * value:.2g} per kJ"
    if resource.use.kind == "room" and sample_mass_kg > 0.0:
        return f"{value / sample_mass_kg:.2g} per kg"
    return f"{value:.2g} per {'sample' if resource.use.kind == 'room' else 'slot'}"


def _relaxed(resource: Resource, explanation: Explanation) -> str:
    values = (explanation.relaxed or {}).get(resource.use.robot)
    if values is None or resource.use.kind == "slots":
        return "-"
    if resource.use.kind == "energy":
        return f"{_small(1000.0 * values.per_joule)} per kJ"
    mass = explanation.sample_mass_kg
    return f"{_small(values.per_sample / mass)} per kg" if mass else f"{_small(values.per_sample)} per sample"


def _small(value: float) -> str:
    """Return a figure; what is only the rounding of a solver is 0."""
    return f"{value:.2g}" if value > 1e-6 else "0"


def _summary(explanation: Explanation) -> str:
    """Return in one sentence each what is scarce and what is not."""
    if all(resource.verdict == "open" for resource in explanation.resources):
        return "Open: not decided in the time given; the figures are what was found, not what is proven."
    lines = []
    for verdict, words in (
        ("binds", "Scarce (more of it lowers J): "),
        ("slack", "Not scarce (as much more as was tried lowers J by nothing): "),
        ("open", "Open (not decided in the time given): "),
    ):
        named = [
            f"{r.use.robot}'s {_NAMES[r.use.kind]}" for r in explanation.resources if r.verdict == verdict
        ]
        if named:
            lines.append(f"{words}{', '.join(named)}.")
    return "\n".join(lines)


def _drop_table(explanation: Explanation) -> Table:
    table = Table(box=None, pad_edge=False)
    for heading in ("where", "what is handed over", "no drops there", "those samples left out"):
        table.add_column(heading)
    for place in explanation.places:
        table.add_row(
            place.place.node,
            ", ".join(
                f"{count} from {sender} to {receiver}" for sender, receiver, count in place.place.drops
            ),
            _rise(place.trial, explanation.information),
            _left_out(place, explanation.information),
        )
    table.add_row("anywhere", "all of it", _rise(explanation.without_drops, explanation.information), "")
    return table


def _rise(trial: Trial | None, information: float) -> str:
    """Return what forbidding costs; what is found without proof can only be better."""
    if trial is None:
        return "not known"
    rise = -trial.fall
    if rise <= 1e-6 * information:
        return f"nothing; {energy_words(trial.energy_j)} more" if trial.energy_j > 0.05 else "nothing"
    figure = f"{rise:.4f} ({_percent(rise, information)})"
    return figure if trial.proven else f"at most {figure}"


def _left_out(place: DropPlace, information: float) -> str:
    rise = place.place.left_out
    return "they must come home" if rise is None else f"{rise:.4f} ({_percent(rise, information)})"


def _drop_words() -> str:
    return (
        "The figures say by how much J rises. No drops there: the whole team is planned anew and may hand "
        "over anywhere else. Those samples left out: every route stays as it is, but the samples that change "
        "hands there are not taken."
    )


def _relaxed_words() -> str:
    return (
        "Relaxed: what a little more is worth in the continuous relaxation (samples and routes in "
        "fractions), from its multipliers; a guide where planning again proves nothing."
    )


def energy_words(energy_j: float) -> str:
    """Return an energy with three or four figures."""
    return f"{energy_j / 1000.0:.2f} kJ" if abs(energy_j) >= 1000.0 else f"{energy_j:.1f} J"


def _percent(part: float, whole: float) -> str:
    return f"{100.0 * part / whole:.1f} %" if whole > 0.0 else "-"
