"""Writes the Python module of our MAVLink dialect: ``python -m groundstation.mavlink.generate``.

It runs when the package is built, never when it is imported: an installed station may lie on
a read-only disk. The module knows sar_radio.xml and, beside ``common``, ArduPilot's own messages,
for a frame whose id is not known cannot be checked against its CRC. Beside the module lies a
small table of what framing and routing need, so that these never import 2 MB of classes. The
same inputs give the same bytes.
"""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from groundstation.domain.errors import GroundstationError, InternalError, ResourceError

DEFINITIONS_PATH = Path(__file__).with_name("sar_radio.xml")
OUTPUT_FOLDER = Path(__file__).with_name("generated")
MODULE_NAME = "sar_radio.py"
TABLE_NAME = "message_table.py"

# Not an include of sar_radio.xml itself: that file is for other people's tool chains too, and
# there it must go with any dialect that rests on common.
_ROOT_XML = """<?xml version="1.0"?>
<mavlink>
  <include>sar_radio.xml</include>
  <include>ardupilotmega.xml</include>
  <version>3</version>
  <dialect>0</dialect>
  <messages/>
</mavlink>
"""
_PACKAGE_DOCSTRING = '"""Generated at build time by ``python -m groundstation.mavlink.generate``."""\n'


def generate(output_folder: Path = OUTPUT_FOLDER, definitions_path: Path = DEFINITIONS_PATH) -> Path:
    """Generates the dialect's module and message table in ``output_folder``; returns the module's path.

    Raises ResourceError where pymavlink is missing or the folder cannot be written, InternalError
    where the definitions are not valid MAVLink.
    """
    try:
        from pymavlink.generator import mavgen, mavparse
    except ImportError as error:
        raise ResourceError(
            f"cannot generate the MAVLink dialect: {error}; install pymavlink 2.4.50 (the dev extra has it)"
        ) from error

    shipped = Path(mavgen.__file__).parent.parent / "dialects" / "v20"
    with tempfile.TemporaryDirectory(prefix="sar-radio-") as folder_name:
        # mavgen resolves includes beside the including file only.
        folder = Path(folder_name)
        for path in sorted(shipped.glob("*.xml")):
            shutil.copyfile(path, folder / path.name)
        shutil.copyfile(definitions_path, folder / "sar_radio.xml")
        root = folder / "station.xml"
        root.write_text(_ROOT_XML, encoding="utf-8")
        generated = folder / "generated" / MODULE_NAME
        generated.parent.mkdir()
        said = io.StringIO()
        options = mavgen.Opts(
            str(generated.with_suffix("")),
            wire_protocol=mavparse.PROTOCOL_2_0,
            language="Python3",
            validate=True,
        )
        succeeded = False
        fault = ""
        try:
            # mavgen reports on stdout and leaves by exit().
            with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
                succeeded = bool(mavgen.mavgen(options, [str(root)])) and generated.exists()
        except SystemExit as error:
            fault = str(error.code)
        except Exception as error:
            fault = f"{type(error).__name__}: {error}"
        if not succeeded:
            lines = [line for line in f"{fault}\n{said.getvalue()}".splitlines() if line.strip()]
            telling = next((line for line in lines if "error" in line.lower()), fault or "no reason given")
            raise InternalError(
                f"{definitions_path} is not valid MAVLink: {telling.strip()}".replace(f"{folder_name}/", "")
            )
        module_source = generated.read_text(encoding="utf-8")
        with contextlib.redirect_stdout(said):
            messages = _definitions(mavparse, root)
        table_source = _message_table(messages)
    _write(output_folder / "__init__.py", _PACKAGE_DOCSTRING)
    _write(output_folder / TABLE_NAME, table_source)
    _write(output_folder / MODULE_NAME, module_source)
    return output_folder / MODULE_NAME


def _definitions(mavparse: Any, root: Path) -> list[Any]:
    """Every message that ``root`` and what it includes define, by id."""
    messages: dict[int, Any] = {}
    seen: set[Path] = set()
    waiting = [root]
    while waiting:
        path = waiting.pop()
        if path in seen:
            continue
        seen.add(path)
        definitions = mavparse.MAVXML(str(path), mavparse.PROTOCOL_2_0)
        messages.update({message.id: message for message in definitions.message})
        waiting += [path.with_name(name) for name in definitions.include]
    return [messages[message_id] for message_id in sorted(messages)]


def _message_table(messages: list[Any]) -> str:
    """Source of the table: id → (name, CRC_EXTRA, lengths, offsets of the target fields)."""
    rows = []
    for message in messages:
        offsets = {field.name: field.wire_offset for field in message.ordered_fields}
        if message.name == "MANUAL_CONTROL":
            # The one message that names its target system otherwise.
            offsets["target_system"] = offsets["target"]
        row = (
            message.name,
            message.crc_extra,
            message.wire_min_length,
            message.wire_length,
            offsets.get("target_system"),
            offsets.get("target_component"),
        )
        rows.append(f"    {message.id}: {row!r},\n")
    return (
        '"""Generated beside sar_radio.py: what framing and routing need of each message."""\n\n'
        "# id: (name, CRC_EXTRA, payload length without extensions, payload length,\n"
        "#      offset of target_system, offset of target_component; None: no such field)\n"
        f"MESSAGES = {{\n{''.join(rows)}}}\n"
    )


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Replaced whole: another process may be importing it.
        partial = path.with_suffix(f".{os.getpid()}.partial")
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        raise ResourceError(f"cannot write the MAVLink dialect to {path}: {error.strerror}") from error


def main() -> int:
    """Command line: generates in place, says where."""
    try:
        path = generate()
    except GroundstationError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    print(f"wrote {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
