"""Runs every benchmark, one process each, and writes what they measured to out/bench.json.

A claim of speed is a ratio against a named alternative in the same run: a benchmark prints
one JSON object (``name``, ``figures``, ``ratios``, ``environment``), and this prints them together.

    python benchmarks/run.py [NAME ...]     # e.g. framing ingest
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
OUT = HERE.parent / "out" / "bench.json"


def run(path: Path) -> dict[str, Any]:
    """One benchmark's JSON; raises SystemExit with its last words when it fails."""
    began = time.monotonic()
    done = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SystemExit(f"{path.name} failed:\n{done.stderr.strip()[-2000:]}")
    text = done.stdout
    result: dict[str, Any] = json.loads(text[text.index("{") :])
    result["wall_s"] = round(time.monotonic() - began, 1)
    return result


def show(value: Any, indent: str = "    ") -> None:
    """Nested figures, one a line."""
    for key, entry in value.items():
        if isinstance(entry, dict):
            print(f"{indent}{key}")
            show(entry, indent + "  ")
        else:
            print(f"{indent}{key:<48} {entry}")


def main() -> None:
    """Run the named benchmarks, or all."""
    wanted = sys.argv[1:]
    paths = [
        p for p in sorted(HERE.glob("bench_*.py")) if not wanted or p.stem.removeprefix("bench_") in wanted
    ]
    if not paths:
        names = ", ".join(p.stem.removeprefix("bench_") for p in sorted(HERE.glob("bench_*.py")))
        raise SystemExit(f"no such benchmark: {' '.join(wanted)}; there are: {names}")
    results = {}
    for number, path in enumerate(paths, 1):
        print(f"[{number}/{len(paths)}] {path.stem}", flush=True)
        results[path.stem] = run(path)
        show({k: v for k, v in results[path.stem].items() if k != "environment"})
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(json.dumps(results, indent=2) + "\n")
    print(f"written: {OUT.relative_to(HERE.parent)}")


if __name__ == "__main__":
    main()
