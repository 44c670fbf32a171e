"""MAVLink URLs: by which wire or radio a vehicle is reached."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, cast, get_args

Scheme: TypeAlias = Literal["udpin", "udpout", "tcp", "serial"]
FORMS = "udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD"

_MAX_PORT = 2**16 - 1
_MAX_BAUD = 4_000_000


@dataclass(frozen=True)
class LinkUrl:
    """One MAVLink URL, taken apart.

    Attributes
    ----------
    scheme
        ``udpin`` listens and answers whoever speaks, ``udpout`` and ``tcp`` call, ``serial`` opens a device.
    place
        Host (an IPv6 address stands in brackets in the URL), or device.
    number
        Port, or bauds.
    """

    scheme: Scheme
    place: str
    number: int

    def __str__(self) -> str:
        place = f"[{self.place}]" if ":" in self.place and self.scheme != "serial" else self.place
        return f"{self.scheme}:{place}:{self.number}"


def parse_link_url(text: str) -> LinkUrl:
    """Take a MAVLink URL apart.

    Raises
    ------
    ValueError
        In one line, with what would be right.
    """
    scheme, _, rest = text.partition(":")
    place, _, number = rest.rpartition(":")
    if scheme not in get_args(Scheme) or not place or not (number.isascii() and number.isdecimal()):
        raise ValueError(f"'{text}' is not a link: expected {FORMS}")
    unit, most = ("baud rate", _MAX_BAUD) if scheme == "serial" else ("port", _MAX_PORT)
    if not 0 < int(number[:9]) <= most:
        raise ValueError(f"'{text}' is not a link: the {unit} is from 1 to {most}")
    if scheme != "serial":
        place = place.removeprefix("[").removesuffix("]")
        try:
            place.encode("idna")
        except UnicodeError:
            raise ValueError(f"'{text}' is not a link: '{place}' is no host") from None
    return LinkUrl(cast(Scheme, scheme), place, int(number))
