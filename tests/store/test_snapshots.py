"""Snapshots: exact round trips, whole or not there, nothing that could run."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from groundstation.domain.errors import InputError, InternalError, ResourceError
from groundstation.store.snapshots import (
    Snapshot,
    SnapshotStore,
    decode_snapshot,
    encode_snapshot,
    load_snapshot,
    save_snapshot,
)

ARRAYS = hnp.arrays(
    st.sampled_from([np.float64, np.float32, np.int64, np.uint8, np.bool_, np.complex128, np.dtype("<U3")]),
    hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
)
LEAVES = (
    st.none()
    | st.booleans()
    | st.integers(-(2**200), 2**200)
    | st.floats()
    | st.text(st.characters(), max_size=8)
    | st.binary(max_size=20)
    | ARRAYS
)
KEYS = st.text(max_size=6) | st.sampled_from(["$array", "$dict", "$"])
TREES = st.recursive(
    LEAVES,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(KEYS, inner, max_size=3)
        | st.lists(inner, max_size=3).map(tuple)
    ),
    max_leaves=12,
)


def same(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray):
        return (
            isinstance(b, np.ndarray)
            and a.dtype == b.dtype
            and a.shape == b.shape
            and a.tobytes() == np.ascontiguousarray(b).tobytes()
        )
    if type(a) is not type(b):
        return False
    if isinstance(a, dict):
        return list(a) == list(b) and all(same(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, float) and math.isnan(a):
        return math.isnan(b)
    return bool(a == b)


@settings(max_examples=300, deadline=None)
@given(TREES)
def test_round_trip_is_exact(tree: Any) -> None:
    data = encode_snapshot(Snapshot(12, 34, tree))
    back = decode_snapshot(data, "x")
    assert (back.seq, back.time_ns) == (12, 34)
    assert same(back.state, tree)
    assert encode_snapshot(back) == data


def test_the_state_of_a_random_generator_survives() -> None:
    state = np.random.default_rng(7).bit_generator.state
    assert decode_snapshot(encode_snapshot(Snapshot(0, 0, state)), "x").state == state


def test_arrays_come_back_writable_and_numpy_scalars_plain() -> None:
    back = decode_snapshot(encode_snapshot(Snapshot(0, 0, {"a": np.zeros(3), "b": np.float32(1.5)})), "x")
    back.state["a"][0] = 1.0
    assert type(back.state["b"]) is float


@pytest.mark.parametrize(
    ("tree", "where"),
    [
        ({"a": [{"b": object()}]}, r"state\.a\[0\]\.b is a object"),
        ({"a": {1: 2}}, r"state\.a has the key 1"),
        ({"a": np.array([object()])}, r"state\.a is an array of object"),
        ({"a": {1, 2}}, r"state\.a is a set"),
    ],
)
def test_what_cannot_be_kept_is_named_by_its_place(tree: Any, where: str) -> None:
    with pytest.raises(InternalError, match=where):
        encode_snapshot(Snapshot(0, 0, tree))


def test_any_cut_or_flipped_bit_is_noticed() -> None:
    data = encode_snapshot(Snapshot(5, 6, {"x": np.arange(4.0), "y": "text"}))
    for position in range(len(data)):
        flipped = bytearray(data)
        flipped[position] ^= 0x10
        with pytest.raises(InputError):
            decode_snapshot(bytes(flipped), "x")
        with pytest.raises(InputError):
            decode_snapshot(data[:position], "x")


def test_keeps_the_newest_few_and_passes_over_damaged_ones(tmp_path: Path) -> None:
    store = SnapshotStore(tmp_path / "snapshots", keep=3)
    assert store.newest() == (None, [])
    for seq in (5, 100, 20, 1000):
        store.save(Snapshot(seq, seq, {"seq": seq}))
    names = sorted(path.name for path in (tmp_path / "snapshots").iterdir())
    assert names == [f"{seq:012d}.snapshot" for seq in (20, 100, 1000)]
    newest = tmp_path / "snapshots" / names[-1]
    newest.write_bytes(newest.read_bytes()[:-1])
    snapshot, events = store.newest(77)
    assert snapshot is not None
    assert snapshot.seq == 100
    assert [(event.code, event.time_ns) for event in events] == [("snapshot.damaged", 77)]


def test_a_newer_format_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("groundstation.store.snapshots.FORMAT_VERSION", 2)
    save_snapshot(tmp_path / "a", Snapshot(0, 0, None))
    monkeypatch.undo()
    with pytest.raises(InputError, match="snapshot format 2; this version reads 1"):
        load_snapshot(tmp_path / "a")


def test_a_write_that_fails_leaves_the_old_file_and_no_litter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a"
    save_snapshot(path, Snapshot(1, 1, "old"))

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ResourceError, match="No space left"):
        save_snapshot(path, Snapshot(2, 2, "new"))
    assert load_snapshot(path).state == "old"
    assert [item.name for item in tmp_path.iterdir()] == ["a"]
