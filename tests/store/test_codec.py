"""Records survive the way to bytes and back, exactly, whatever is in them."""

from __future__ import annotations

import typing
import zlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.domain.command import Proposal
from groundstation.domain.errors import InputError, InternalError
from groundstation.domain.geometry import Geodetic
from groundstation.domain.inputs import (
    AnyInput,
    ConnectionInput,
    Decision,
    Direction,
    DropInput,
    FrameInput,
    JoinInput,
    MissionInput,
    OperatorInput,
    PlanInput,
    Record,
    SessionInput,
    TickInput,
)
from groundstation.domain.mission import Area, FlightLimits, LastKnownPlace, Mission, Terrain
from groundstation.store.codec import (
    CLASS_OF,
    CRC,
    HEAD,
    KIND_OF,
    decode_record,
    dump_json,
    encode_record,
    from_plain,
    to_plain,
)

ANY_TEXT = st.text(st.characters(), max_size=20)  # lone surrogates included
ANY_FLOAT = st.floats(allow_nan=False)
U64 = st.integers(0, 2**64 - 1)
I64 = st.integers(-(2**63), 2**63 - 1)
PLACE = st.builds(Geodetic, ANY_FLOAT, ANY_FLOAT, ANY_FLOAT)
RING = st.lists(st.tuples(ANY_FLOAT, ANY_FLOAT), max_size=5).map(tuple)
AREA = st.builds(Area, st.lists(st.lists(RING, max_size=3).map(tuple), max_size=3).map(tuple), ANY_TEXT)
MISSION = st.builds(
    Mission,
    revision=I64,
    origin=st.none() | PLACE,
    search_area=st.none() | AREA,
    fence=st.none() | AREA,
    target_height_min_m=ANY_FLOAT,
    target_height_max_m=ANY_FLOAT,
    ground_amsl_m=st.none() | ANY_FLOAT,
    height_reference=ANY_TEXT,
    limits=st.builds(FlightLimits, *[ANY_FLOAT] * 6),
    last_known=st.lists(
        st.builds(LastKnownPlace, *[ANY_FLOAT] * 3, ANY_TEXT, st.none() | U64), max_size=3
    ).map(tuple),
    terrain=st.none()
    | st.builds(Terrain, *[ANY_FLOAT] * 4, I64, st.lists(st.none() | I64, max_size=5).map(tuple), ANY_TEXT),
)
PROPOSAL = st.builds(
    Proposal,
    proposal_id=ANY_TEXT,
    vehicle_id=I64,
    beacon_id=U64,
    position=PLACE,
    height_above_home_m=ANY_FLOAT,
    reason=ANY_TEXT,
    created_ns=I64,
    expires_ns=I64,
    mission_revision=I64,
    target_sequence=I64,
)
INPUTS: dict[type, st.SearchStrategy[AnyInput]] = {
    FrameInput: st.builds(FrameInput, ANY_TEXT, st.sampled_from(Direction), st.binary(max_size=300)),
    TickInput: st.builds(TickInput),
    MissionInput: st.builds(MissionInput, MISSION, ANY_TEXT),
    OperatorInput: st.builds(
        OperatorInput, ANY_TEXT, st.sampled_from(Decision), st.none() | ANY_TEXT, st.none() | I64
    ),
    ConnectionInput: st.builds(ConnectionInput, ANY_TEXT, ANY_TEXT, ANY_TEXT),
    DropInput: st.builds(DropInput, ANY_TEXT, st.lists(st.tuples(I64, U64, I64), max_size=5).map(tuple)),
    PlanInput: st.builds(
        PlanInput, I64, st.lists(PROPOSAL, max_size=3).map(tuple), st.lists(ANY_TEXT, max_size=3).map(tuple)
    ),
    SessionInput: st.builds(SessionInput, ANY_TEXT, ANY_TEXT),
    JoinInput: st.builds(JoinInput, ANY_TEXT, U64, st.none() | U64),
}
RECORD = st.builds(Record, U64, I64, I64, st.one_of(*INPUTS.values()))


def decode(data: bytes) -> Record:
    _, kind, _, length, seq, time_ns, unix_us = HEAD.unpack_from(data)
    payload = data[HEAD.size : HEAD.size + length]
    assert CRC.unpack(data[HEAD.size + length :])[0] == zlib.crc32(data[: HEAD.size + length])
    return decode_record(kind, seq, time_ns, unix_us, payload)


def test_every_kind_of_input_has_a_number_and_a_strategy_here() -> None:
    kinds = set(typing.get_args(AnyInput))
    assert set(KIND_OF) == kinds == set(INPUTS)
    assert len(CLASS_OF) == len(KIND_OF)


@settings(max_examples=400, deadline=None)
@given(RECORD)
def test_round_trip_is_exact(record: Record) -> None:
    back = decode(encode_record(record))
    assert back == record
    assert type(back.input) is type(record.input)
    # Equal is not enough: 1.0 == 1 == True, and a signed zero equals zero.
    assert repr(back) == repr(record)


def test_nan_survives() -> None:
    place = Geodetic(float("nan"), float("inf"), float("-inf"))
    back = decode(encode_record(Record(0, 0, 0, MissionInput(Mission(origin=place), "x"))))
    assert repr(back.input.mission.origin) == repr(place)


def test_an_older_file_takes_the_default_of_a_newer_field() -> None:
    plain = to_plain(OperatorInput("ann", Decision.HOLD_ALL))
    del plain["vehicle_id"]
    assert from_plain(OperatorInput, plain) == OperatorInput("ann", Decision.HOLD_ALL)


def test_a_newer_file_is_refused_by_name() -> None:
    plain = to_plain(SessionInput("began", "1")) | {"weather": "rain"}
    with pytest.raises(InputError, match=r"SessionInput.*'weather'.*another version"):
        from_plain(SessionInput, plain)
    with pytest.raises(InputError, match="kind 99"):
        decode_record(99, 0, 0, 0, b"{}")


def test_a_wrong_type_in_the_file_is_refused() -> None:
    payload = dump_json({"event": 3, "version": "1"})
    with pytest.raises(InputError, match="3 where str"):
        decode_record(KIND_OF[SessionInput], 0, 0, 0, payload)


def test_what_cannot_be_kept_is_an_internal_error() -> None:
    with pytest.raises(InternalError, match="knows no input"):
        encode_record(Record(0, 0, 0, "text"))  # type: ignore[arg-type]
    with pytest.raises(InternalError, match="does not fit"):
        encode_record(Record(-1, 0, 0, TickInput()))
