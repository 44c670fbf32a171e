"""KML 2.2 (OGC 07-147r2): folders for the site, the drops and each robot, to be switched on and off."""

from __future__ import annotations

import json
from itertools import groupby
from xml.etree import ElementTree as ET

from malipp_field.vehicle.map_features import Feature

_NAMESPACE = "http://www.opengis.net/kml/2.2"
_FOLDERS = {"fence": "site", "keep_out": "site", "node": "site", "drop": "drops"}


def kml_text(name: str, features: list[Feature]) -> str:
    """Return the text of a KML file."""
    root = ET.Element("kml", xmlns=_NAMESPACE)
    document = _add(root, "Document")
    _add(document, "name", name)
    for folder, members in groupby(features, lambda f: _FOLDERS.get(f.kind) or f.robot or ""):
        group = _add(document, "Folder")
        _add(group, "name", folder)
        for feature in members:
            _placemark(group, feature)
    ET.indent(root, " ")
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _placemark(folder: ET.Element, feature: Feature) -> None:
    """Add a feature; the order of the children is the schema's."""
    placemark = _add(folder, "Placemark")
    _add(placemark, "name", feature.title)
    if feature.lines:
        _add(placemark, "description", "\n".join(feature.lines))
    _style(placemark, feature)
    extended = _add(placemark, "ExtendedData")
    for key, value in (("id", feature.id), ("kind", feature.kind), ("robot", feature.robot), *feature.data):
        if value is not None:
            data = _add(extended, "Data")
            data.set("name", key)
            _add(data, "value", value if isinstance(value, str) else json.dumps(value))
    _geometry(placemark, feature)


def _style(placemark: ET.Element, feature: Feature) -> None:
    style = _add(placemark, "Style")
    if feature.shape == "Point":
        icon = _add(style, "IconStyle")  # the viewer's own picture: in the field there is no other
        _add(icon, "color", _abgr(feature.color))
        _add(icon, "scale", "0.6" if feature.kind == "node" else "1")
        return
    line = _add(style, "LineStyle")
    _add(line, "color", _abgr(feature.color))
    _add(line, "width", str(feature.width))
    if feature.shape == "Polygon":
        fill = 0x40 if feature.kind == "keep_out" else 0
        _add(_add(style, "PolyStyle"), "color", _abgr(feature.color, fill))


def _geometry(placemark: ET.Element, feature: Feature) -> None:
    shape = _add(placemark, feature.shape)
    ring = shape
    if feature.shape != "Point":
        _add(shape, "tessellate", "1")  # on the ground, not straight through a hill
    if feature.shape == "Polygon":
        ring = _add(_add(shape, "outerBoundaryIs"), "LinearRing")
    _add(ring, "coordinates", " ".join(f"{lon:.8f},{lat:.8f}" for lat, lon in feature.places))


def _abgr(color: str, alpha: int = 0xFF) -> str:
    """Return ``#rrggbb`` as KML has it."""
    red, green, blue = color[1:3], color[3:5], color[5:7]
    return f"{alpha:02x}{blue}{green}{red}"


def _add(parent: ET.Element, tag: str, text: str | None = None) -> ET.Element:
    child = ET.SubElement(parent, tag)
    child.text = text
    return child
