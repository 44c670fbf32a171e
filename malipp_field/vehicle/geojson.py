"""GeoJSON (RFC 7946): one feature collection, with the properties that simplestyle 1.1 gives a look to."""

from __future__ import annotations

import json

from malipp_field.vehicle.map_features import Feature, Json

_SYMBOLS = {"depot": "warehouse", "start": "triangle", "candidate": "circle-stroked", "via": "circle"}


def geojson_text(features: list[Feature]) -> str:
    """Return the text of a GeoJSON file; every feature's ``kind`` says what it is."""
    collection: Json = {"type": "FeatureCollection", "features": [_feature(feature) for feature in features]}
    return json.dumps(collection, indent=1, ensure_ascii=False) + "\n"


def _feature(feature: Feature) -> Json:
    properties: dict[str, Json] = {"kind": feature.kind, "title": feature.title}
    if feature.robot is not None:
        properties["robot"] = feature.robot
    if feature.lines:
        properties["description"] = "\n".join(feature.lines)
    properties |= dict(feature.data) | _style(feature)
    return {"type": "Feature", "id": feature.id, "geometry": _geometry(feature), "properties": properties}


def _geometry(feature: Feature) -> Json:
    # Longitude first; eight decimals are a millimetre.
    places: list[Json] = [[round(lon, 8), round(lat, 8)] for lat, lon in feature.places]
    if feature.shape == "Point":
        return {"type": "Point", "coordinates": places[0]}
    return {"type": feature.shape, "coordinates": [places] if feature.shape == "Polygon" else places}


def _style(feature: Feature) -> dict[str, Json]:
    if feature.shape == "LineString":
        return {"stroke": feature.color, "stroke-width": feature.width, "stroke-opacity": 1.0}
    if feature.shape == "Polygon":
        opacity = 0.25 if feature.kind == "keep_out" else 0.0
        return {
            "stroke": feature.color, "stroke-width": feature.width, "stroke-opacity": 1.0,
            "fill": feature.color, "fill-opacity": opacity,
        }  # fmt: skip
    style: dict[str, Json] = {
        "marker-color": feature.color,
        "marker-size": "small" if feature.kind == "node" else "medium",
    }
    role = dict(feature.data).get("role")
    symbol = "cross" if feature.kind == "drop" else _SYMBOLS.get(str(role))
    return style if symbol is None else style | {"marker-symbol": symbol}
