"""Link URLs: both spellings mean the same, and a wrong one says what was seen and what is allowed."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.connections.urls import LinkKind, LinkUrl, parse_url
from groundstation.domain.errors import InputError


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("udpin:0.0.0.0:14550", "udpin:0.0.0.0:14550"),
        ("udpin://0.0.0.0:14550", "udpin:0.0.0.0:14550"),
        ("udp:127.0.0.1:14550", "udpin:127.0.0.1:14550"),
        ("udp://:14540", "udpin:0.0.0.0:14540"),
        ("udpin::14550", "udpin:0.0.0.0:14550"),
        ("udpout:192.168.1.9:14550", "udpout:192.168.1.9:14550"),
        ("udpout://gcs.local:14550", "udpout:gcs.local:14550"),
        ("tcp:127.0.0.1:5760", "tcp:127.0.0.1:5760"),
        ("tcpout://127.0.0.1:5760", "tcp:127.0.0.1:5760"),
        ("tcpin://:5790", "tcpin:0.0.0.0:5790"),
        ("UDPIN:[::1]:14550", "udpin:[::1]:14550"),
        ("serial:/dev/ttyUSB0:57600", "serial:/dev/ttyUSB0:57600"),
        ("serial:///dev/ttyACM0:115200", "serial:/dev/ttyACM0:115200"),
        ("serial:/dev/serial/by-id/usb-FTDI:00", None),
        ("serial:/dev/ttyUSB0", "serial:/dev/ttyUSB0:57600"),
        ("serial:COM3:57600", "serial:COM3:57600"),
    ],
)
def test_forms(text: str, name: str | None) -> None:
    if name is None:
        with pytest.raises(InputError, match="not a baud rate"):
            parse_url(text)
        return
    url = parse_url(text)
    assert url.name == name
    assert parse_url(url.name) == url


@pytest.mark.parametrize(
    ("text", "seen"),
    [
        ("", "no colon"),
        ("14550", "no colon"),
        ("http://127.0.0.1:80", "unknown kind 'http'"),
        ("udpin:127.0.0.1", "is not HOST:PORT"),
        ("udpin:127.0.0.1:abc", "'abc' is not a port"),
        ("udpin:127.0.0.1:70000", "'70000' is not a port"),
        ("udpout:127.0.0.1:0", "'0' is not a port from 1"),
        ("udpout::14550", "the host is missing"),
        ("tcp:a:b:1", "is not HOST:PORT"),
        ("serial:", "the device is missing"),
        ("serial:/dev/ttyUSB0:fast", "'fast' is not a baud rate"),
        ("serial:/dev/ttyUSB0:1", "1 is not a baud rate"),
        ("udpin:[::1:14550", "is not HOST:PORT"),
    ],
)
def test_wrong_ones_are_told_in_one_line(text: str, seen: str) -> None:
    with pytest.raises(InputError) as failure:
        parse_url(text)
    message = str(failure.value)
    assert seen in message
    assert "for example udpin:0.0.0.0:14550" in message
    assert "\n" not in message


@given(st.text(max_size=40))
def test_nothing_but_input_errors(text: str) -> None:
    with contextlib.suppress(InputError):
        assert isinstance(parse_url(text), LinkUrl)


def test_kinds() -> None:
    assert parse_url("tcpin:1.2.3.4:1") == LinkUrl(LinkKind.TCP_SERVER, "1.2.3.4", 1)
    assert parse_url("serial:/dev/x:9600") == LinkUrl(LinkKind.SERIAL, "", 0, "/dev/x", 9600)
