"""Bad input: one clear line that says what was seen and what is needed, never a traceback."""

from __future__ import annotations

import json
import logging
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from groundstation.cli import main

AREA = {
    "type": "Polygon",
    "coordinates": [
        [[149.16, -35.37], [149.17, -35.37], [149.17, -35.36], [149.16, -35.36], [149.16, -35.37]]
    ],
}


@pytest.fixture(autouse=True)
def _restore_logs() -> Iterator[None]:
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield
    root.handlers[:], root.level = handlers, level
    logging.getLogger("groundstation").setLevel(logging.NOTSET)


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["serve"], 2, ["--link"]),
        (["serve", "--link", "udpin:nowhere"], 1, ["udpin:nowhere", "udpin:"]),
        (["serve", "--link", "carrier-pigeon:1"], 1, ["carrier-pigeon", "serial:"]),
        (["serve", "--link", "udpin:127.0.0.1:0", "--http", "here"], 1, ["here", "HOST:PORT"]),
        (["serve", "--link", "udpin:127.0.0.1:0", "--area", "none.json"], 1, ["none.json"]),
        (["serve", "--link", "udpin:127.0.0.1:0", "--area", "broken.json"], 1, ["broken.json"]),
        (["serve", "--link", "udpin:127.0.0.1:0", "--fence", "point.json"], 1, ["point.json", "Polygon"]),
        (["serve", "--link", "udpin:127.0.0.1:0", "--area", "point.json"], 1, ["point.json", "radius_m"]),
        (["serve", "--link", "udpin:127.0.0.1:0", "--terrain", "flat.asc"], 1, ["flat.asc", "--area"]),
        (
            ["serve", "--link", "udpin:127.0.0.1:0", "--area", "area.json", "--terrain", "flat.asc"],
            1,
            ["flat.asc", "ncols"],
        ),
        (["serve", "--link", "udpin:127.0.0.1:0", "--config", "bad.toml"], 1, ["bad.toml"]),
        (
            ["serve", "--link", "udpin:127.0.0.1:0", "--set", "server.prot=1"],
            1,
            ["server.prot", "server.port"],
        ),
        (["serve", "--frobnicate"], 2, ["--frobnicate"]),
        (["serve", "--link", "udpin:127.0.0.1:0", "--resume", "."], 1, ["session"]),
        (["replay", "none.tlog"], 1, ["none.tlog"]),
        (["replay", "garbage.tlog"], 1, ["garbage.tlog"]),
        (["replay", "empty.tlog"], 1, ["empty.tlog"]),
        (["demo", "--headless", "--scenario", "atlantis"], 1, ["atlantis", "open-field"]),
        (["demo", "--headless", "--scenario", "bad.toml"], 1, ["bad.toml"]),
        (["train", "--data", "garbage.tlog", "--out", "m"], 1, ["garbage.tlog"]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_bad_input_is_one_clear_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    code: int,
    words: list[str],
) -> None:
    """In this process, as the console script is called: loading everything anew each time takes seconds."""
    (tmp_path / "broken.json").write_text('{"type": "Polygon"')
    (tmp_path / "point.json").write_text(json.dumps({"type": "Point", "coordinates": [149, -35]}))
    (tmp_path / "area.json").write_text(json.dumps(AREA))
    (tmp_path / "flat.asc").write_text("0 0 0\n0 0 0\n")
    (tmp_path / "bad.toml").write_text("[server]\nport = 'eight thousand'\n")
    (tmp_path / "garbage.tlog").write_bytes(b"this is no recording of anything at all" * 20)
    (tmp_path / "empty.tlog").write_bytes(b"")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["groundstation", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr().err
    assert ended.value.code == code, said
    assert "Traceback" not in said
    assert "internal error" not in said
    if code == 1:
        assert len(said.strip().splitlines()) == 1, said
    for word in words:
        assert word in said, said


def test_an_occupied_http_port_is_said_before_anything_begins(cli, tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        done = cli("serve", "--link", "udpin:127.0.0.1:0", "--http", f"127.0.0.1:{port}")
    assert done.returncode == 1
    assert str(port) in done.stderr
    assert not (tmp_path / "sessions").exists()


def test_a_missing_radio_does_not_stop_the_others(background, tmp_path: Path, until) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    (tmp_path / "area.json").write_text(json.dumps(AREA))
    station = background(
        "groundstation.cli", "serve", "--link", "serial:/dev/ttyNOWHERE:57600",
        "--link", "udpin:127.0.0.1:0", "--http", f"127.0.0.1:{port}", "--area", "area.json",
    )  # fmt: skip
    until("the missing device is told", lambda: "ttyNOWHERE" in station.text())
    until("the other radio is open", lambda: "udpin:127.0.0.1:0: open" in station.text())
    assert station.stop() == 0
    assert "Traceback" not in station.text()


def test_help_teaches(cli) -> None:
    for arguments in ([], ["serve"], ["replay"], ["demo"], ["train"], ["config", "show"]):
        done = cli(*arguments, "--help")
        assert done.returncode == 0
        assert len(done.stdout) > 200, done.stdout


def test_config_show_prints_a_file_that_can_be_used(cli, tmp_path: Path) -> None:
    shown = cli("config", "show", "--set", "server.port=8123", GROUNDSTATION_LIMITS__CEILING_M="90")
    assert shown.returncode == 0, shown.stderr
    assert "command line" in shown.stdout
    assert "environment GROUNDSTATION_LIMITS__CEILING_M" in shown.stdout
    (tmp_path / "again.toml").write_text(shown.stdout)
    again = cli("config", "show", "--config", "again.toml")
    assert again.returncode == 0, again.stderr
    assert "port = 8123" in again.stdout
