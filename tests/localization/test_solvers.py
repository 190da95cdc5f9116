"""The documentation's table of methods is the registry's."""

from __future__ import annotations

from pathlib import Path

import pytest

from groundstation.localization import METHODS
from groundstation.localization.solvers import SOLVERS

PAGE = (Path(__file__).parents[2] / "docs" / "methods.md").read_text(encoding="utf-8")
ROWS = {
    cells[0].strip("`"): cells
    for cells in (
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in PAGE.splitlines()
        if line.startswith("| `") and line.count("|") == 5 and "±" not in line
    )
}


def test_the_page_has_every_method_in_order() -> None:
    assert tuple(ROWS) == METHODS


@pytest.mark.parametrize("name", SOLVERS)
def test_the_page_says_what_the_registry_says(name: str) -> None:
    _, _, equations, needs = ROWS[name]
    assert (equations, needs) == (SOLVERS[name].equations, SOLVERS[name].needs())


@pytest.mark.parametrize("name", METHODS)
def test_the_page_describes_every_method(name: str) -> None:
    described = [line for line in PAGE.splitlines() if line.startswith("- **") and f"**`{name}`**" in line]
    assert len(described) == 1
