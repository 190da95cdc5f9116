"""Link URLs: ours (``udpin:HOST:PORT``) and MAVSDK's (``udpin://HOST:PORT``), one meaning each."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum

from groundstation.domain.errors import InputError

DEFAULT_BAUD = 57_600
ALLOWED = (
    "allowed are udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT,"
    " serial:DEVICE:BAUD and MAVSDK's forms with ://, for example udpin:0.0.0.0:14550"
    " or serial:/dev/ttyUSB0:57600"
)


class LinkKind(StrEnum):
    """What is opened."""

    UDP_IN = "udpin"
    """Listens; many vehicles may speak to it."""
    UDP_OUT = "udpout"
    """Speaks first, to one address; whoever answers is heard."""
    TCP_CLIENT = "tcp"
    TCP_SERVER = "tcpin"
    SERIAL = "serial"


_SCHEMES = {
    "udp": LinkKind.UDP_IN,
    "udpin": LinkKind.UDP_IN,
    "udpout": LinkKind.UDP_OUT,
    "tcp": LinkKind.TCP_CLIENT,
    "tcpout": LinkKind.TCP_CLIENT,
    "tcpin": LinkKind.TCP_SERVER,
    "serial": LinkKind.SERIAL,
}
_LISTENING = (LinkKind.UDP_IN, LinkKind.TCP_SERVER)


@dataclass(frozen=True, slots=True)
class LinkUrl:
    """One parsed URL."""

    kind: LinkKind
    host: str
    """To listen on or to speak to; empty for serial ports."""
    port: int
    """0 for serial ports; of a listener: any free port."""
    device: str = ""
    """Path or name of the serial port."""
    baud: int = 0

    @property
    def name(self) -> str:
        """The canonical text: names the connection in journal, counters and messages."""
        if self.kind is LinkKind.SERIAL:
            return f"serial:{self.device}:{self.baud}"
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.kind.value}:{host}:{self.port}"


def parse_url(text: str) -> LinkUrl:
    """The link that ``text`` names. Raises InputError: what was seen and what is allowed."""
    scheme, colon, rest = text.strip().partition(":")
    kind = _SCHEMES.get(scheme.lower())
    if kind is None or not colon:
        seen = f"unknown kind {scheme!r}" if colon else "no colon"
        raise _wrong(text, seen)
    rest = rest.removeprefix("//")
    if kind is LinkKind.SERIAL:
        return _serial(text, rest)
    found = re.fullmatch(r"(?:\[(?P<v6>[^\]]*)\]|(?P<host>[^:/\[\]]*)):(?P<port>[^:/]*)/?", rest)
    if found is None:
        raise _wrong(text, f"{rest!r} is not HOST:PORT")
    host = found["v6"] or found["host"] or ""
    if not host:
        if kind not in _LISTENING:
            raise _wrong(text, "the host is missing")
        host = "0.0.0.0"
    return LinkUrl(kind, host, _port(text, found["port"], least=0 if kind in _LISTENING else 1))


def _serial(text: str, rest: str) -> LinkUrl:
    # By the last colon: device names on some systems have colons of their own.
    device, colon, baud_text = rest.rpartition(":")
    if not colon or not baud_text.isdecimal():
        if colon and not re.search(r"[/\\]", baud_text):
            raise _wrong(text, f"{baud_text!r} is not a baud rate")
        device, baud_text = rest, str(DEFAULT_BAUD)
    baud = int(baud_text)
    if not device:
        raise _wrong(text, "the device is missing")
    if not 300 <= baud <= 4_000_000:
        raise _wrong(text, f"{baud} is not a baud rate from 300 to 4000000")
    return LinkUrl(LinkKind.SERIAL, "", 0, device, baud)


def _port(text: str, port_text: str, least: int) -> int:
    if not (port_text.isascii() and port_text.isdecimal()) or not least <= int(port_text) <= 65_535:
        raise _wrong(text, f"{port_text!r} is not a port from {least} to 65535")
    return int(port_text)


def _wrong(text: str, seen: str) -> InputError:
    return InputError(f"cannot use link URL {text!r}: {seen}; {ALLOWED}")
