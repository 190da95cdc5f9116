"""What every benchmark says of itself: where it ran, and its figures as one JSON object."""

from __future__ import annotations

import json
import os
import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any


def environment(*packages: str) -> dict[str, Any]:
    """The machine, how busy it is, Python, and the versions of what is measured."""
    return {
        "python": platform.python_version(),
        "machine": platform.machine(),
        "system": platform.platform(),
        "cores": os.cpu_count(),
        "load_1min": round(os.getloadavg()[0], 2),
        **{name: version(name) for name in packages},
    }


def give(report: dict[str, Any], out: Path | None = None) -> None:
    """Print the report, and write it where asked to."""
    text = json.dumps(report, indent=2, ensure_ascii=False)
    print(text)
    if out is not None:
        out.write_text(text + "\n", encoding="utf-8")
