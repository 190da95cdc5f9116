"""The house rules that a linter does not know: who may touch the outside world."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PURE_ROOMS = (
    "domain",
    "mavlink",
    "measurement",
    "channel",
    "localization",
    "tracking",
    "guidance",
    "safety",
    "engine",
)
OUTSIDE = {
    "asyncio",
    "socket",
    "threading",
    "multiprocessing",
    "subprocess",
    "time",
    "random",
    "pickle",
    "secrets",
}
# Files a pure room may keep beside its core, each with the reason in its header.
EXCEPTIONS = {
    "groundstation/channel/training": "training is a command of its own, never part of the service",
    "groundstation/mavlink/generated": "generated",
    "groundstation/mavlink/generate.py": "a build step",
}


def modules() -> list[Path]:
    found = [p for room in PURE_ROOMS for p in sorted((ROOT / "groundstation" / room).rglob("*.py"))]
    return [p for p in found if not any(str(p.relative_to(ROOT)).startswith(e) for e in EXCEPTIONS)]


def imported_roots(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names.add(node.module.split(".")[0])
    return names


@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(ROOT)))
def test_pure_rooms_do_not_touch_the_outside(path: Path) -> None:
    touched = imported_roots(path) & OUTSIDE
    assert not touched, f"{path.relative_to(ROOT)} imports {sorted(touched)}: only the shell may"


@pytest.mark.parametrize("package", ["groundstation", "sim_sitl"])
def test_every_module_says_why_it_exists(package: str) -> None:
    silent = [
        str(p.relative_to(ROOT))
        for p in sorted((ROOT / package).rglob("*.py"))
        if "generated" not in p.parts
        and p.read_text().strip()
        and ast.get_docstring(ast.parse(p.read_text())) is None
    ]
    assert silent == []


def test_the_simulator_shares_nothing_with_the_station_but_wire_and_values() -> None:
    """Or the tests would check the station's models against themselves."""
    for path in sorted((ROOT / "sim_sitl").rglob("*.py")):
        if "studies" in path.parts:
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            names: list[str] = []
            if isinstance(node, ast.ImportFrom) and node.module:
                names = [node.module]
            elif isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            for name in names:
                if name.startswith("groundstation."):
                    assert name.split(".")[1] in {"domain", "mavlink"}, f"{path.name} imports {name}"
