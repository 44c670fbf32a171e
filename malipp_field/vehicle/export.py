"""Mission files for ground stations, or a map; with either, what ties every item back to the plan."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Literal

from malipp_field.errors import InputError, PlanError
from malipp_field.mission import Mission
from malipp_field.mission.schema import Origin
from malipp_field.plan import Plan
from malipp_field.vehicle.compile import Compiled, compile_plan
from malipp_field.vehicle.geojson import geojson_text
from malipp_field.vehicle.kml import kml_text
from malipp_field.vehicle.layout import lay_out
from malipp_field.vehicle.map_features import map_features
from malipp_field.vehicle.qgc_plan import qgc_plan_text
from malipp_field.vehicle.steps import VehicleMission
from malipp_field.vehicle.wpl import wpl_text

ExportFormat = Literal["plan", "wpl", "kml", "geojson"]
_SUFFIXES: dict[ExportFormat, str] = {
    "plan": ".plan", "wpl": ".waypoints", "kml": ".kml", "geojson": ".geojson",
}  # fmt: skip
_MAPS = ("kml", "geojson")


def export(
    mission: Mission, plan: Plan, kind: ExportFormat, directory: Path, start_s: float | None = None
) -> list[Path]:
    """Write the mission files or the map of a plan.

    Each robot gets ``<mission>-<robot>.plan`` or ``.waypoints``, or the team ``<mission>.kml`` or
    ``.geojson``; ``<mission>-steps.json`` ties every item to its step, stop, action and containers. A robot
    that stays where it is gets no mission file, since ground stations refuse an empty mission; one from an
    earlier export is removed. All files are written, or none.

    Parameters
    ----------
    mission, plan
        A verified plan and the mission it is for.
    kind
        ``plan`` for QGroundControl, ``wpl`` for `QGC WPL 110`; ``kml`` and ``geojson`` are maps.
    directory
        Where to; made when it is not there.
    start_s
        When mission time 0 is, in seconds since the Unix epoch. Without it no gate opens by time.

    Returns
    -------
    list of Path
        The files written, those of the robots first, in the order of the plan.

    Raises
    ------
    PlanError
        When the site is abstract or the plan cannot be compiled.
    InputError
        When the files cannot be written.
    """
    origin = mission.site.origin
    if origin is None:
        raise PlanError(
            f"mission '{mission.name}' has no site.origin: an abstract site has no degrees to export"
        )
    compiled = compile_plan(mission, plan, start_s=start_s)
    if kind in _MAPS:
        features = map_features(mission, origin, plan, compiled, start_s)
        names = dict.fromkeys(compiled.missions, f"{mission.name}{_SUFFIXES[kind]}")
        text = geojson_text(features) if kind == "geojson" else kml_text(mission.name, features)
        texts = {f"{mission.name}{_SUFFIXES[kind]}": text}
    else:
        names = {robot: f"{mission.name}-{robot}{_SUFFIXES[kind]}" for robot in compiled.missions}
        texts = {
            names[vehicle.robot]: _text(mission, origin, vehicle, kind)
            for vehicle in compiled.missions.values()
            if vehicle.steps
        }
    texts[f"{mission.name}-steps.json"] = _map_text(plan, compiled, names)
    return _write_all(directory, texts, obsolete=[name for name in names.values() if name not in texts])


def _text(mission: Mission, origin: Origin, vehicle: VehicleMission, kind: ExportFormat) -> str:
    return qgc_plan_text(mission, origin, vehicle) if kind == "plan" else wpl_text(origin, vehicle)


def _map_text(plan: Plan, compiled: Compiled, names: dict[str, str]) -> str:
    """Return what each item of each file stands for, as JSON; `item` is its number in the vehicle."""
    document = {
        "format": "malipp-steps/1",
        "mission": plan.mission,
        "version": plan.version,
        "robots": [
            {
                "id": robot,
                "file": names[robot] if vehicle.steps else None,
                "items": [
                    {"item": item, **vehicle.steps[index].model_dump(mode="json", exclude={"place"})}
                    for item, index in enumerate(lay_out(vehicle).steps)
                    if index >= 0
                ],
            }
            for robot, vehicle in compiled.missions.items()
        ],
        "samples": [sample.model_dump(mode="json") for sample in compiled.samples.values()],
    }
    return json.dumps(document, indent=1) + "\n"


def _write_all(directory: Path, texts: dict[str, str], obsolete: list[str]) -> list[Path]:
    """Write all files under temporary names first, so that a fault leaves what was there before."""
    partial = {directory / name: directory / f"{name}.partial" for name in texts}
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for path, temporary in partial.items():
            temporary.write_text(texts[path.name], encoding="utf-8")
        for path, temporary in partial.items():
            temporary.replace(path)
        for name in obsolete:
            (directory / name).unlink(missing_ok=True)
    except OSError as fault:
        for temporary in partial.values():
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
        raise InputError(str(directory), None, "", f"cannot be written: {fault.strerror}") from None
    return list(partial)
