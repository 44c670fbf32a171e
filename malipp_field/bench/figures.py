"""Figures of the studies, as PNG and SVG.

Colours are those of Okabe and Ito, told apart by readers who do not see all colours. Whiskers and bands are
95 % confidence intervals of the mean.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullFormatter, ScalarFormatter

from malipp_field.bench import paper
from malipp_field.bench.cases import Cases, mean
from malipp_field.bench.instances import Specification
from malipp_field.bench.studies import SEQ
from malipp_field.bench.tasks import Row
from malipp_field.documents import whole_file

_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00")
_PAPER = "#444444"
_SAID: dict[str, Any] = {
    "linestyle": "none", "marker": "D", "color": "white", "markeredgecolor": _PAPER, "markersize": 6
}  # fmt: skip
_DPI = 160
_POINTS = 240
"""Of a curve."""
_LEAST_GAIN = -20.0
"""Per cent below which curves are cut: first plans say nothing beside the rest."""
_STYLE: dict[Any, Any] = {
    "font.size": 10, "axes.titlesize": 11, "axes.spines.top": False, "axes.spines.right": False,
    "axes.grid": True, "grid.color": "#dddddd", "grid.linewidth": 0.6, "axes.axisbelow": True,
    "legend.frameon": False, "svg.hashsalt": "malipp-field", "svg.fonttype": "none",
}  # fmt: skip


def draw(cases: Cases, stem: Path) -> tuple[Path, ...]:
    """Draw a study's figure and return the files, ``stem`` with .png and .svg; nothing without results.

    Raises
    ------
    InputError
        When a file cannot be written.
    """
    with mpl.rc_context(_STYLE):
        figure = _DRAWN[cases.study.name](cases)
        return () if figure is None else tuple(_save(figure, stem, kind) for kind in ("png", "svg"))


def _save(figure: Figure, stem: Path, kind: str) -> Path:
    path = stem.with_name(f"{stem.name}.{kind}")
    with whole_file(path) as partial:
        dates: dict[str, Any] = {"metadata": {"Date": None}} if kind == "svg" else {}
        figure.savefig(partial, format=kind, dpi=_DPI, **dates)
    return path


def _joint(cases: Cases) -> Figure | None:
    """Draw bars of the gain by team size, one a method, with the paper's means as diamonds."""
    figure, axes = _figure(6.4, 4.0)
    labels = [arm.label for arm in cases.study.planned if arm.label != SEQ]
    width = 0.8 / max(1, len(labels))
    drawn = False
    for i, label in enumerate(labels):
        found = [(x, mean(cases.gains(cell, label))) for x, cell in enumerate(cases.study.cells)]
        known = [(x + (i - (len(labels) - 1) / 2) * width, gains) for x, gains in found if gains is not None]
        if not known:
            continue
        drawn = True
        places = [x for x, _ in known]
        values = [gains.value for _, gains in known]
        axes.bar(places, values, 0.9 * width, color=_COLOURS[i], label=label)
        for place, gains in known:
            if gains.half is not None:
                axes.errorbar(place, gains.value, gains.half, fmt="none", ecolor="#222222", capsize=4)
        papers = [paper.JOINT_GAINS.get(label, {}).get(cell.robots) for cell in cases.study.cells]
        offset = (i - (len(labels) - 1) / 2) * width
        said = [(x + offset, value) for x, value in enumerate(papers) if value is not None]
        axes.plot([x for x, _ in said], [value for _, value in said], **_SAID)
    if not drawn:
        return None
    axes.plot([], [], **_SAID, label="the paper's means")
    axes.set_xticks(range(len(cases.study.cells)), [_size(cell) for cell in cases.study.cells])
    axes.set_ylabel("gain over Seq-LIPP (%)")
    axes.grid(visible=False, axis="x")
    axes.axhline(0.0, color="#222222", linewidth=0.8)
    figure.legend(loc="outside lower center", ncols=3)
    _title(axes, cases)
    return figure


def _sweep(cases: Cases) -> Figure | None:
    """Draw the mean gain over sensing ratio and sample mass as a heat map with its figures."""
    ratios = sorted({cell.noise_ratio for cell in cases.study.cells})
    masses = sorted({cell.sample_mass_kg for cell in cases.study.cells})
    gains = {
        (cell.noise_ratio, cell.sample_mass_kg): mean(cases.gains(cell, "full")) for cell in cases.study.cells
    }
    if not any(gains.values()):
        return None
    values = np.array([
        [math.nan if (found := gains[ratio, mass]) is None else found.value for mass in masses]
        for ratio in reversed(ratios)
    ])  # fmt: skip
    figure, axes = _figure(6.4, 4.6)
    top = max(float(np.nanmax(values)), 1e-6)
    bottom = min(0.0, float(np.nanmin(values)))
    image = axes.imshow(values, cmap="viridis", aspect="auto", vmin=bottom, vmax=top)
    for i, ratio in enumerate(reversed(ratios)):
        for j, mass in enumerate(masses):
            found = gains[ratio, mass]
            if found is not None:
                half = "" if found.half is None else f"\n± {found.half:.1f}"
                colour = "black" if found.value - bottom > 0.6 * (top - bottom) else "white"
                text = f"{found.value:.1f}{half}"
                axes.text(j, i, text, ha="center", va="center", color=colour, fontsize=9)
    axes.set_xticks(range(len(masses)), [f"{mass:g}" for mass in masses])
    axes.set_yticks(range(len(ratios)), [f"{ratio:g}" for ratio in reversed(ratios)])
    axes.set_xlabel("sample mass λ (kg; an empty robot has 1 kg)")
    axes.set_ylabel("noise ratio σ²worst / σ²best")
    axes.grid(visible=False)
    figure.colorbar(image, ax=axes, label="gain over Seq-LIPP (%)")
    _title(axes, cases)
    return figure


def _optimality(cases: Cases) -> Figure | None:
    """Draw found against certified J, and beside it how far above the optimum each plan is."""
    labels = [arm.label for arm in cases.study.planned if arm.label != "exact"]
    points = {
        label: [
            (exact, row)
            for cell in cases.study.cells
            for exact, row in cases.pairs(cell, label, base="exact")
            if exact.certified
        ]
        for label in labels
    }
    if not any(points.values()):
        return None
    figure = Figure(figsize=(9.2, 4.2), layout="constrained")
    scatter, gaps = figure.subplots(1, 2)
    marks = ("o", "x", "+")
    for i, label in enumerate(labels):
        optimum = np.array([exact.information for exact, _ in points[label]], dtype=float)
        found = np.array([row.information for _, row in points[label]], dtype=float)
        face = "none" if marks[i] == "o" else _COLOURS[i]
        edge = {"edgecolors": _COLOURS[i]} if marks[i] == "o" else {}
        scatter.scatter(optimum, found, s=34, marker=marks[i], facecolors=face, label=label, **edge)
        above = np.sort(np.maximum(100.0 * (found / optimum - 1.0), 1e-4))[::-1]
        share = 100.0 * np.arange(1, len(above) + 1) / max(1, len(above))
        gaps.step(share, above, where="pre", color=_COLOURS[i], label=label)
    ends = np.array(scatter.get_xlim())
    scatter.plot(ends, ends, color=_PAPER, linewidth=0.8, zorder=0)
    scatter.set_xlabel("certified optimum of J")
    scatter.set_ylabel("J found")
    scatter.legend(loc="upper left")
    _title(scatter, cases)
    gaps.set_yscale("log")
    gaps.axhline(100 * paper.MATCH, color=_PAPER, linewidth=0.8, linestyle=":")
    gaps.axhline(100 * paper.NEAR, color=_PAPER, linewidth=0.8, linestyle="--")
    gaps.annotate("matched", (99, 100 * paper.MATCH), ha="right", va="bottom", fontsize=9, color=_PAPER)
    gaps.annotate("within 1 %", (99, 100 * paper.NEAR), ha="right", va="bottom", fontsize=9, color=_PAPER)
    gaps.set_xlim(0, 100)
    gaps.set_xlabel("share of the certified instances (%), worst first")
    gaps.set_ylabel("above the optimum (%)")
    gaps.set_title("How far off", loc="left")
    return figure


def _scalability(cases: Cases) -> Figure | None:
    """Draw the mean gain over time, a panel a size, with the paper's end and the proven ceiling."""
    cells = cases.study.cells
    figure = Figure(figsize=(1.2 + 3.6 * len(cells), 4.0), layout="constrained")
    panels = figure.subplots(1, len(cells), sharey=True, squeeze=False)[0]
    drawn = [_curves(axes, cases, cell) for axes, cell in zip(panels, cells, strict=True)]
    if not any(drawn):
        return None
    panels[0].set_ylabel("gain over Seq-LIPP (%)")
    handles, labels = panels[drawn.index(True)].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(3, len(cells)))
    panels[0].set_ylim(bottom=max(_LEAST_GAIN, panels[0].get_ylim()[0]))
    return figure


def _curves(axes: Axes, cases: Cases, cell: Specification) -> bool:
    labels = [arm.label for arm in cases.study.planned if arm.label != SEQ]
    drawn = False
    for i, label in enumerate(labels):
        rows = [row for _, row in cases.pairs(cell, label)]
        times = _times(rows)
        found = [(time_s, mean(cases.gains_at(cell, label, time_s) or [])) for time_s in times]
        curve = [(time_s, gains) for time_s, gains in found if gains is not None]
        if not curve:
            continue
        drawn = True
        x = [time_s for time_s, _ in curve]
        axes.plot(x, [gains.value for _, gains in curve], color=_COLOURS[i], label=label, linewidth=1.8)
        low, high = [gains.low for _, gains in curve], [gains.high for _, gains in curve]
        axes.fill_between(x, low, high, color=_COLOURS[i], alpha=0.2, linewidth=0)
        ceiling = mean(cases.most_gains(cell, label))
        if ceiling is not None:
            what = f"ceiling by the bound of {label}"
            axes.axhline(ceiling.value, color=_COLOURS[i], linestyle="--", linewidth=1.2, label=what)
    said = paper.SCALABILITY_GAINS.get(cell.robots)
    if said is not None and drawn:
        axes.axhline(said, color=_PAPER, linestyle=":", linewidth=1.2, label="the paper after 1800 s")
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("seconds since planning began")
    count = len(cases.of(cell, SEQ))
    axes.set_title(f"{_size(cell)}, {count} instance{'s' * (count != 1)}", loc="left")
    return drawn


def _times(rows: list[Row]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the times of a curve: from when all rows have a plan to the longest row's end."""
    firsts = [row.first_plan_s for row in rows if row.first_plan_s is not None]
    if not firsts:
        return np.zeros(0)
    end = max(row.time_s for row in rows)
    return np.geomspace(max(1e-2, *firsts), max(end, 2e-2, *firsts), _POINTS)


def _growth(cases: Cases) -> Figure | None:
    """Draw time and memory against the number of robots."""
    figure = Figure(figsize=(9.2, 4.0), layout="constrained")
    clock, memory = figure.subplots(1, 2)
    drawn = False
    for i, arm in enumerate(cases.study.planned):
        colour = _COLOURS[i]
        drawn |= _line(clock, cases, arm.label, lambda row: row.time_s, colour, f"{arm.label}: end")
        if arm.label != SEQ:
            _line(
                clock,
                cases,
                arm.label,
                lambda row: row.first_plan_s,
                colour,
                f"{arm.label}: first plan",
                "--",
            )
        _line(memory, cases, arm.label, lambda row: row.peak_mib, colour, arm.label)
    if not drawn:
        return None
    for axes, what in ((clock, "seconds"), (memory, "peak memory of the process (MiB)")):
        axes.set_xscale("log")
        axes.set_yscale("log")
        sizes = [cell.robots for cell in cases.study.cells]
        axes.set_xticks(sizes, [str(size) for size in sizes])
        axes.set_xticks([], minor=True)
        axes.set_xlabel("robots (ten candidates each)")
        axes.set_ylabel(what)
        axes.legend(loc="upper left")
    memory.yaxis.set_minor_locator(MaxNLocator(1))
    clock.set_title("Time", loc="left")
    memory.set_title("Memory", loc="left")
    return figure


def _line(
    axes: Axes, cases: Cases, label: str, figure_of: Callable[[Row], float | None], colour: str, name: str,
    style: str = "-",
) -> bool:  # fmt: skip
    """Draw the mean of a figure of the rows against team size; tell whether there was any."""
    found = []
    for cell in cases.study.cells:
        values = [value for row in cases.of(cell, label) if (value := figure_of(row)) is not None]
        if values:
            found.append((cell.robots, sum(values) / len(values)))
    if found:
        axes.plot(*zip(*found, strict=True), style, marker="o", markersize=4, color=colour, label=name)
    return bool(found)


def _figure(width_in: float, height_in: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    return figure, figure.subplots()


def _title(axes: Axes, cases: Cases) -> None:
    axes.set_title(cases.study.title, loc="left")


def _size(cell: Specification) -> str:
    return f"{cell.robots} robots, {cell.candidates} candidates"


_DRAWN: dict[str, Callable[[Cases], Figure | None]] = {
    "joint": _joint,
    "sweep": _sweep,
    "optimality": _optimality,
    "scalability": _scalability,
    "growth": _growth,
}
