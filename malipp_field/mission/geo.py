"""Degrees to local metres and back (WGS 84, east-north-up at the site's origin).

Most sites are in metres: pymap3d is imported at the first place in degrees.
"""

from __future__ import annotations

from malipp_field.mission.schema import Origin, Place

# Where an abstract site (one without an origin) lies while it is simulated: MAVLink knows only degrees, and
# ArduPilot takes a waypoint at latitude 0, longitude 0 to mean "here".
ABSTRACT_ORIGIN = Origin(lat_deg=1.0, lon_deg=1.0, alt_m=0.0)


def to_local(lat_deg: float, lon_deg: float, origin: Origin) -> tuple[float, float]:
    """Return (east, north) in metres of a place at the origin's altitude."""
    import pymap3d

    x_m, y_m, _ = pymap3d.geodetic2enu(
        lat_deg, lon_deg, origin.alt_m, origin.lat_deg, origin.lon_deg, origin.alt_m
    )
    return float(x_m), float(y_m)


def to_globe(x_m: float, y_m: float, origin: Origin) -> tuple[float, float]:
    """Return (latitude, longitude) in degrees of a place in the local horizontal plane."""
    import pymap3d

    lat_deg, lon_deg, _ = pymap3d.enu2geodetic(x_m, y_m, 0.0, origin.lat_deg, origin.lon_deg, origin.alt_m)
    return float(lat_deg), float(lon_deg)


def locate(place: Place, origin: Origin | None) -> tuple[float, float]:
    """Return (east, north) in metres of a place given either way.

    Raises
    ------
    ValueError
        When the place is in degrees and the site has no origin.
    """
    if place.x_m is not None and place.y_m is not None:
        return place.x_m, place.y_m
    if origin is None:
        raise ValueError("a place in degrees needs site.origin")
    assert place.lat_deg is not None
    assert place.lon_deg is not None
    return to_local(place.lat_deg, place.lon_deg, origin)
