"""Settings: which layer wins, where a value came from, and what a wrong one is told."""

from __future__ import annotations

import importlib
import tomllib
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import get_type_hints

import pytest

import groundstation
from groundstation.config import Config, LoadedConfig, load_config, parse_assignments
from groundstation.config.settings_tree import Leaf, build, is_section, leaves, unit_of
from groundstation.config.values import needed, read_value
from groundstation.domain.errors import InputError


def value_of(loaded: LoadedConfig, path: str) -> tuple[object, str]:
    (found,) = [value for value in loaded.describe() if value.path == path]
    return found.value, found.origin


def write(tmp_path: Path, text: str) -> Path:
    file = tmp_path / "station.toml"
    file.write_text(text, encoding="utf-8")
    return file


def test_every_setting_is_documented() -> None:
    undocumented = [leaf.path for leaf in leaves(Config) if not leaf.doc]
    assert undocumented == []
    assert len(leaves(Config)) > 80


def sections(kind: type) -> set[type]:
    found = {kind}
    for annotation in get_type_hints(kind).values():
        if is_section(annotation):
            found |= sections(annotation)
    return found


def test_no_rooms_settings_are_forgotten() -> None:
    package = Path(groundstation.__file__).parent
    rooms = sorted(path.parent.name for path in package.glob("*/settings.py"))
    assert len(rooms) >= 9
    for room in rooms:
        module = importlib.import_module(f"groundstation.{room}.settings")
        declared = {
            item
            for name, item in vars(module).items()
            if name.endswith("Settings") and is_section(item) and item.__module__ == module.__name__
        }
        assert declared
        assert declared <= sections(Config), room


def test_a_setting_without_a_docstring_would_be_found() -> None:
    @dataclass(frozen=True)
    class Bad:
        documented_m: float = 1.0
        """Metres."""
        silent: int = 2

    assert [leaf.doc for leaf in leaves(Bad)] == ["Metres.", ""]
    assert [leaf.unit for leaf in leaves(Bad)] == ["m", ""]


def test_defaults_are_those_of_the_rooms() -> None:
    loaded = load_config()
    assert loaded.config == Config()
    assert {value.origin for value in loaded.values} == {"default"}


def test_layers(tmp_path: Path) -> None:
    file = write(
        tmp_path,
        '[server]\nport = 1\nhost = "file"\n[measurement]\nwindow_samples = 5\n[limits]\nceiling_m = 90\n',
    )
    environment = {
        "GROUNDSTATION_SERVER__PORT": "2",
        "GROUNDSTATION_MEASUREMENT__WINDOW_SAMPLES": "6",
        "PATH": "/bin",
    }
    loaded = load_config({"server.port": 3, "server.host": None}, environment, file)
    assert loaded.config.server.port == 3
    assert value_of(loaded, "server.port") == (3, "command line")
    assert value_of(loaded, "measurement.window_samples") == (
        6,
        "environment GROUNDSTATION_MEASUREMENT__WINDOW_SAMPLES",
    )
    assert value_of(loaded, "server.host") == ("file", f"file {file}")
    assert value_of(loaded, "limits.ceiling_m") == (90.0, f"file {file}")
    assert type(loaded.config.limits.ceiling_m) is float
    assert value_of(loaded, "limits.floor_m") == (20.0, "default")


def test_lists_paths_and_none(tmp_path: Path) -> None:
    file = write(tmp_path, 'links = ["udpin:0.0.0.0:14550"]\nfence = "fence.geojson"\ndata_dir = "/var/s"\n')
    config = load_config(
        {"target.ground_amsl_m": "none"}, {"GROUNDSTATION_FORWARD": "udpout:a:1, tcp:b:2"}, file
    ).config
    assert config.links == ("udpin:0.0.0.0:14550",)
    assert config.forward == ("udpout:a:1", "tcp:b:2")
    assert config.fence == tmp_path / "fence.geojson"
    assert config.data_dir == Path("/var/s")
    assert config.area is None
    assert load_config({"area": Path("here.geojson"), "links": ("a", "b")}).config.links == ("a", "b")
    assert load_config({}, {"GROUNDSTATION_LINKS": '["a,b"]'}).config.links == ("a,b",)
    assert load_config({}, {"GROUNDSTATION_FORWARD_COMMANDS": "true"}).config.forward_commands is True


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("[server]\nport = 'abc'", ["station.toml: server.port is 'abc'", "a whole number", "default 8000"]),
        ("[server]\nport = 80.5", ["server.port is 80.5", "a whole number"]),
        ("[server]\nport = true", ["server.port is True", "a whole number"]),
        ("[server]\nport = 70000", ["server.port is 70000", "from 0 to 65535"]),
        ("[limits]\nceiling_m = '120'", ["limits.ceiling_m is '120'", "a number"]),
        ("[limits]\nceiling_m = nan", ["limits.ceiling_m is nan", "a finite number"]),
        ("[limits]\nceiling_m = inf", ["limits.ceiling_m is inf", "a finite number"]),
        ("[limits]\nseparation_m = -1", ["limits.separation_m is -1", "0 or more"]),
        ("[limits]\nfloor_m = 200", ["limits.floor_m is 200", "limits.ceiling_m is 120", "the smaller"]),
        ("[measurement]\nwindow_age_s = -4", ["measurement.window_age_s is -4", "of 0 or more"]),
        ("[channel]\nprior_los_probability = 1.5", ["from 0 to 1"]),
        ("forward_commands = 1", ["forward_commands is 1", "true or false"]),
        ("links = 'udpin:a:1'", ["links is 'udpin:a:1'", "a list, each text"]),
        ("[server]\nprot = 1", ["station.toml: there is no setting server.prot", "did you mean server.port"]),
        ("port = 1", ["there is no setting port", "server.port"]),
        ("[sever]\nport = 1", ["there is no setting sever"]),
        ("server = 3", ["server is 3", "a table [server]"]),
        ("[server", ["station.toml: not valid TOML"]),
        ("data_dir = 2026-11-22", ["data_dir is", "a path"]),
    ],
)
def test_a_wrong_file_is_told_where_what_and_what_is_needed(
    tmp_path: Path, text: str, parts: list[str]
) -> None:
    file = write(tmp_path, text)
    with pytest.raises(InputError) as caught:
        load_config(file=file)
    message = str(caught.value)
    assert "\n" not in message.replace("\n(", "")
    for part in parts:
        assert part in message


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot read .*absent\.toml: No such file"):
        load_config(file=tmp_path / "absent.toml")


def test_wrong_environment_and_command_line() -> None:
    with pytest.raises(
        InputError, match=r"environment GROUNDSTATION_SERVER__PROT: there is no setting server\.prot"
    ):
        load_config({}, {"GROUNDSTATION_SERVER__PROT": "1"})
    with pytest.raises(InputError, match=r"environment GROUNDSTATION_SERVER__PORT: server\.port is 'x'"):
        load_config({}, {"GROUNDSTATION_SERVER__PORT": "x"})
    with pytest.raises(InputError, match=r"command line: server\.port is '-1'"):
        load_config({"server.port": "-1"})
    with pytest.raises(InputError, match=r"server is a group of settings; one of server\.host"):
        load_config({"server": "1"})


def test_assignments() -> None:
    assert parse_assignments(["server.port=1", " links = a=b"]) == {"server.port": "1", "links": " a=b"}
    with pytest.raises(InputError, match=r"'server\.port' sets nothing; NAME=VALUE"):
        parse_assignments(["server.port"])


def test_the_printed_text_is_a_settings_file_that_gives_the_same(tmp_path: Path) -> None:
    loaded = load_config({"server.port": "1234", "links": 'a"b,c', "limits.ceiling_m": "99.5"})
    text = loaded.text()
    assert "# command line: " in text
    assert "# default [m]: " in text
    again = load_config(file=write(tmp_path, text.replace('data_dir = "sessions"\n', "")))
    assert again.config == loaded.config
    assert tomllib.loads(text)["server"]["port"] == 1234
    assert loaded.plain()["server.port"] == "1234"


class Colour(StrEnum):
    RED = "red"
    BLUE = "blue"


def test_enums_and_fixed_lists() -> None:
    colour = Leaf("colour", Colour, Colour.RED, "", "")
    assert read_value(colour, "blue", "file", text=False) is Colour.BLUE
    with pytest.raises(InputError, match="one of red, blue"):
        read_value(colour, "green", "command line", text=True)
    assert needed(tuple[int, float]) == "a list of a whole number, a number"
    assert needed(float | None) == "a number, or none"


def test_build_is_the_inverse_of_leaves() -> None:
    assert build(Config, {leaf.path: leaf.default for leaf in leaves(Config)}) == Config()


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("speed_m_s", "m/s"),
        ("age_s", "s"),
        ("rss_dbm", "dBm"),
        ("samples", ""),
        ("valid_s", "s"),
        ("links", ""),
    ],
)
def test_units_by_the_endings_of_names(name: str, unit: str) -> None:
    assert unit_of(name) == unit
