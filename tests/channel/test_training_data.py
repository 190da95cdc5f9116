"""Every way in which a file of responses can be wrong is said before any work is done."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from groundstation.channel.features import features
from groundstation.channel.training.data import CSV_FIELDS, LinkData, read_links, split_by_group
from groundstation.domain.errors import InputError

ROWS, TAPS = 30, 64


def columns() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    magnitude = 0.05 * rng.rayleigh(size=(ROWS, TAPS))
    magnitude[:, 10:20] += 1 + rng.random((ROWS, 10))
    return {
        "cir_magnitude": magnitude,
        "label": np.array(["LOS", "NLOS", "NDP NLOS"] * (ROWS // 3)),
        "tap_spacing_ns": np.array(1.0016),
        "log_id": np.arange(ROWS) // 2,
    }


def write(path: Path, **changes: np.ndarray | None) -> Path:
    arrays = {name: value for name, value in (columns() | changes).items() if value is not None}
    np.savez(path, **arrays)
    return path


def test_reads_what_interfaces_promise(tmp_path: Path) -> None:
    data = read_links(write(tmp_path / "d.npz"))
    assert len(data) == ROWS
    assert data.is_los.sum() == ROWS // 3
    assert data.grouped
    assert np.all(data.packets == 1)
    bare = read_links(write(tmp_path / "bare.npz", log_id=None, tap_spacing_ns=None))
    assert not bare.grouped
    numeric = read_links(
        write(
            tmp_path / "n.npz",
            label=np.arange(ROWS) % 2,
            cir_magnitude=np.rint(1000 * columns()["cir_magnitude"]).astype(np.uint16),
        )
    )
    assert numeric.is_los.sum() == ROWS // 2


def test_packets_of_a_geometry_are_one_link(tmp_path: Path) -> None:
    data = read_links(
        write(
            tmp_path / "d.npz",
            packet=np.tile([0, 1, 2], ROWS // 3),
            log_id=np.arange(ROWS) // 3,
            label=np.repeat(np.arange(ROWS // 3) % 2, 3),
        )
    )
    assert len(data) == ROWS // 3
    assert np.all(data.packets == 3)
    whole = data.batch(np.arange(2), 3, np.zeros(2, np.int64))
    np.testing.assert_array_equal(whole[1], data.inputs[3:6])


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"cir_magnitude": None}, "no array 'cir_magnitude'"),
        ({"label": None}, "no array 'label'"),
        ({"cir_magnitude": np.ones(64)}, "shape \\(64,\\)"),
        ({"cir_magnitude": np.ones((ROWS, 8))}, "at least 16"),
        ({"cir_magnitude": np.ones((0, 64)), "label": np.ones(0)}, "has 0 rows; at least 20"),
        (
            {
                "cir_magnitude": columns()["cir_magnitude"][:9],
                "label": columns()["label"][:9],
                "log_id": None,
            },
            "has 9 rows; at least 20",
        ),
        ({"cir_magnitude": np.ones((ROWS, TAPS), complex)}, "type complex128"),
        ({"cir_magnitude": np.full((ROWS, TAPS), np.nan)}, "NaN or infinity, first in row 0"),
        ({"cir_magnitude": -columns()["cir_magnitude"]}, "negative"),
        ({"label": np.ones(ROWS)}, "both classes"),
        ({"label": np.array(["NLOS"] * ROWS)}, "both classes"),
        ({"label": np.ones(ROWS - 1)}, "must agree"),
        ({"label": np.full(ROWS, np.nan)}, "label has NaN"),
        ({"label": np.array([b"LOS"] * ROWS)}, "seen: LOS"),
        ({"label": np.array(["line", "shade"] * (ROWS // 2))}, "seen: line, shade"),
        ({"label": np.array(["LOS", ""] * (ROWS // 2))}, "label is empty in row 1"),
        ({"label": np.ones(ROWS, complex)}, "text or numbers"),
        ({"tap_spacing_ns": np.array(0.0)}, "not positive"),
        ({"tap_spacing_ns": np.ones(3)}, "tap_spacing_ns has shape"),
        ({"log_id": np.ones(3)}, "log_id has shape"),
        ({"log_id": np.full(ROWS, np.nan)}, "log_id has NaN"),
        ({"cir_magnitude": np.ones((ROWS, TAPS))}, r"cannot be used \(.*constant"),
    ],
)
def test_wrong_arrays_are_said(tmp_path: Path, changes: dict[str, np.ndarray | None], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        read_links(write(tmp_path / "d.npz", **changes))


def test_files_that_are_not_what_they_say(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is not a file"):
        read_links(tmp_path / "nowhere.npz")
    (tmp_path / "text.npz").write_text("hello")
    with pytest.raises(InputError, match="not a NPZ"):
        read_links(tmp_path / "text.npz")
    np.savez(tmp_path / "objects.npz", cir_magnitude=np.ones((2, 64)), label=np.array([object(), object()]))
    with pytest.raises(InputError, match="cannot be read"):
        read_links(tmp_path / "objects.npz")
    whole = write(tmp_path / "whole.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="not a NPZ"):
        read_links(tmp_path / "cut.npz")


def test_csv_in_the_papers_order(tmp_path: Path) -> None:
    arrays = columns()
    front = np.zeros((ROWS, len(CSV_FIELDS)))
    front[:, CSV_FIELDS.index("LOS")] = np.arange(ROWS) % 2
    values = np.hstack([front, arrays["cir_magnitude"]])
    header = ",".join([*CSV_FIELDS, *(f"CIR{tap}" for tap in range(TAPS))])
    np.savetxt(tmp_path / "with.csv", values, delimiter=",", header=header, comments="")
    np.savetxt(tmp_path / "without.csv", values, delimiter=",")
    for name in ("with", "without"):
        data = read_links(tmp_path / f"{name}.csv")
        assert len(data) == ROWS
        assert np.array_equal(data.is_los, np.arange(ROWS) % 2 == 1)
    np.savetxt(
        tmp_path / "other.csv", values, delimiter=",", header=header.replace("LOS", "Sight"), comments=""
    )
    with pytest.raises(InputError, match=r"the header begins with X, Y, Z, Range, Sight.* needed: X"):
        read_links(tmp_path / "other.csv")
    np.savetxt(tmp_path / "narrow.csv", values[:, :12], delimiter=",")
    with pytest.raises(InputError, match="3 CIR columns"):
        read_links(tmp_path / "narrow.csv")
    (tmp_path / "words.csv").write_text("X,Y\nhello,world\n")
    with pytest.raises(InputError, match="has 0 CIR columns; needed: X, Y"):
        read_links(tmp_path / "words.csv")


def csv_text(rows: list[str], header: str | None = None) -> str:
    return "\n".join(([header] if header else []) + rows) + "\n"


def test_csv_of_a_stranger(tmp_path: Path) -> None:
    """Columns by name in any order and case, labels in words, semicolons, a byte-order mark."""
    cir = columns()["cir_magnitude"]
    header = ";".join(["los", *(f'"cir_{tap}"' for tap in range(TAPS)), "tap_spacing_ns", "note"])
    rows = [
        ";".join(["LOS" if row % 2 else "NLOS", *(f"{value:.6g}" for value in cir[row]), "2.5", "7"])
        for row in range(ROWS)
    ]
    (tmp_path / "s.csv").write_text("\ufeff" + csv_text(rows, header), encoding="utf-8")
    data = read_links(tmp_path / "s.csv")
    assert np.array_equal(data.is_los, np.arange(ROWS) % 2 == 1)
    assert not data.grouped
    npz = read_links(write(tmp_path / "d.npz", label=np.arange(ROWS) % 2, tap_spacing_ns=np.array(2.5)))
    np.testing.assert_allclose(data.inputs, npz.inputs, atol=1e-4)


def test_tap_spacing_of_a_csv_is_the_callers_to_say(tmp_path: Path) -> None:
    front = np.zeros((ROWS, len(CSV_FIELDS)))
    front[:, CSV_FIELDS.index("LOS")] = np.arange(ROWS) % 2
    np.savetxt(tmp_path / "d.csv", np.hstack([front, columns()["cir_magnitude"]]), delimiter=",")
    told = read_links(tmp_path / "d.csv", tap_spacing_ns=2.0)
    npz = write(tmp_path / "d.npz", label=np.arange(ROWS) % 2, tap_spacing_ns=np.array(2.0))
    np.testing.assert_allclose(told.inputs, read_links(npz).inputs, atol=1e-4)
    assert not np.allclose(told.inputs, read_links(tmp_path / "d.csv").inputs, atol=1e-4)
    with pytest.raises(InputError, match="a positive number is needed"):
        read_links(tmp_path / "d.csv", tap_spacing_ns=0.0)


def test_rows_that_follow_one_another_are_one_geometry(tmp_path: Path) -> None:
    """A CSV in the paper's columns has no log_id: rows of a track tell it by their positions."""
    front = np.zeros((ROWS, len(CSV_FIELDS)))
    track = np.arange(ROWS) // 10
    front[:, 0] = 50.0 * track + 0.8 * (np.arange(ROWS) % 10)
    front[:, CSV_FIELDS.index("LOS")] = track % 2
    np.savetxt(tmp_path / "d.csv", np.hstack([front, columns()["cir_magnitude"]]), delimiter=",")
    data = read_links(tmp_path / "d.csv")
    assert data.grouped
    # Ten captures of a geometry are a link of eight and one of two.
    assert list(data.packets) == [8, 2] * 3
    assert list(data.group) == [0, 0, 1, 1, 2, 2]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda row: row.replace("0.5", "half", 1), "not a CSV of numbers: .*in line 8"),
        (lambda row: row + ",1", "not a CSV of numbers: .*columns changed from 73 to 74 in line 8"),
        (lambda row: row.replace("0,0,0,0,1", "0,0,0,0,2"), "the LOS column has 2; 1 or 0 is needed"),
        (lambda row: row.replace("0.5", "nan", 1), "NaN or infinity, first in row 6"),
    ],
)
def test_a_bad_line_is_named(tmp_path: Path, change: Callable[[str], str], reason: str) -> None:
    header = ",".join([*CSV_FIELDS, *(f"CIR{tap}" for tap in range(TAPS))])
    rows = [
        ",".join(["0,0,0,0", str((row + 1) % 2), "0,0,0,0,0.5", *(f"{tap % 7}.25" for tap in range(1, TAPS))])
        for row in range(ROWS)
    ]
    rows[6] = change(rows[6])
    (tmp_path / "d.csv").write_text(csv_text(rows, header))
    with pytest.raises(InputError, match=reason):
        read_links(tmp_path / "d.csv")


def test_an_archive_named_csv_is_told(tmp_path: Path) -> None:
    write(tmp_path / "d.npz").rename(tmp_path / "d.csv")
    with pytest.raises(InputError, match=r"is a zip archive \(a NPZ\?\)"):
        read_links(tmp_path / "d.csv")


def test_transposed_in_memory_is_read_alike(tmp_path: Path) -> None:
    ordinary = read_links(write(tmp_path / "c.npz"))
    fortran = read_links(
        write(tmp_path / "f.npz", cir_magnitude=np.asfortranarray(columns()["cir_magnitude"]))
    )
    np.testing.assert_array_equal(ordinary.inputs, fortran.inputs)


def test_features_belong_to_the_captures_that_are_kept(tmp_path: Path) -> None:
    magnitude = columns()["cir_magnitude"]
    magnitude[4] = 1.0
    data = read_links(write(tmp_path / "d.npz", cir_magnitude=magnitude), with_features=True)
    assert data.features is not None
    assert data.left_out == {"constant": 1}
    expected = features(np.delete(magnitude, 4, axis=0), goodness_of_fit=True)
    np.testing.assert_allclose(data.features, expected)
    assert read_links(write(tmp_path / "e.npz")).features is None


def links(group: list[int], is_los: list[bool]) -> LinkData:
    count = len(group)
    return LinkData(
        inputs=np.zeros((count, 4, 128), np.float32),
        first=np.arange(count),
        packets=np.ones(count, np.int64),
        is_los=np.array(is_los),
        group=np.array(group),
        bandwidth_hz=np.full(count, np.nan),
        window_taps=np.full(count, 64),
        left_out={},
        grouped=True,
    )


def test_split_keeps_groups_whole_and_classes_in_every_part() -> None:
    rng = np.random.default_rng(0)
    group = [int(value) for value in rng.integers(0, 20, size=300)]
    data = links(group, [bool(value) for value in rng.random(300) < 0.3])
    parts = split_by_group(data, (0.7, 0.15, 0.15), seed=1)
    assert sorted(np.concatenate(parts)) == list(range(300))
    seen = [set(data.group[part]) for part in parts]
    assert sum(len(groups) for groups in seen) == len(set.union(*seen)) == 20
    assert [len(groups) for groups in seen] == [14, 3, 3]
    again = split_by_group(data, (0.7, 0.15, 0.15), seed=1)
    assert all(np.array_equal(a, b) for a, b in zip(parts, again, strict=True))


def test_impossible_splits_are_said() -> None:
    with pytest.raises(InputError, match=r"2 group\(s\)"):
        split_by_group(links([0, 0, 1, 1], [True, False] * 2), (0.7, 0.15, 0.15), 0)
    with pytest.raises(InputError, match="cannot be split"):
        split_by_group(links([0, 1, 2, 3], [True, False, False, False]), (0.7, 0.15, 0.15), 0)
