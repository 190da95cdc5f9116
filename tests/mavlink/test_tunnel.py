"""Our messages inside TUNNEL: the same typed message comes out."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.domain.errors import InternalError
from groundstation.mavlink.decode import decode
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.encode import Encoder
from groundstation.mavlink.framing import Framer, frame_of
from groundstation.mavlink.messages import CirFragment
from groundstation.mavlink.tunnel import unwrap, wrap

PLAIN = [
    dialect.MAVLink_sar_rss_message(5, 9, 868_000_000, -9000, -32768, 3),
    dialect.MAVLink_sar_aoa_message(5, 9, 0.5, -0.25, 0.125, 0.0, 12),
    dialect.MAVLink_sar_link_state_message(5, 9, 0.75, 0),
]


def cir(data: bytes) -> object:
    """A SAR_CIR with ``data``."""
    filled = list(data.ljust(212, b"\0"))
    return dialect.MAVLink_sar_cir_message(1, 2, 1.0, 0.5, 3.5, 7, 0, 64, 0, 0, 1, 0, len(data), filled)


@pytest.mark.parametrize("message", PLAIN, ids=lambda message: message.get_type())
def test_wrapped_is_as_unwrapped(message: object) -> None:
    encoder = Encoder(1, 191)
    frames = Framer().feed(encoder.pack(message) + encoder.pack(wrap(message)))
    assert [frame.message_id for frame in frames] == [frames[0].message_id, 385]
    assert decode(frames[0]) == decode(frames[1]) is not None


@given(st.binary(max_size=86))
def test_cir_data_survives_with_its_zeros(data: bytes) -> None:
    message = decode(frame_of(Encoder(1, 191).pack(wrap(cir(data)))))
    assert isinstance(message, CirFragment)
    assert message.data == data
    assert message.first_path_index == 3.5


def test_a_cir_that_promises_more_than_came_stays_short() -> None:
    tunnel = wrap(cir(bytes(range(86))))
    # ``length`` is the byte before the data: id 2, fixed part 40.
    tunnel.payload[41] = 212
    message = decode(frame_of(Encoder(1, 191).pack(tunnel)))
    assert isinstance(message, CirFragment)
    assert message.data == bytes(range(86))


def test_too_long_for_a_tunnel() -> None:
    with pytest.raises(InternalError, match="86 bytes of data"):
        wrap(cir(bytes(87)))


def test_other_tunnels_are_nobodys() -> None:
    other = dialect.MAVLink_tunnel_message(0, 0, 200, 40, [1] * 128)
    assert decode(frame_of(Encoder(1, 1).pack(other))) is None
    # Ours, around a message that is not to be tunnelled.
    heartbeat = dialect.MAVLink_tunnel_message(0, 0, 52080, 11, [0] * 128)
    assert decode(frame_of(Encoder(1, 1).pack(heartbeat))) is None


@given(st.binary(max_size=133))
def test_unwrap_never_raises(payload: bytes) -> None:
    inner = unwrap(payload)
    assert inner is None or 0 <= inner[0] <= 0xFFFF
