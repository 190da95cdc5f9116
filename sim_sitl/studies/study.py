"""What a study is made of: sections, each some methods on some cases.

Exists so that tables, figures and their reports are data: a new study is a value, no code.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import Enum


class Shape(Enum):
    """How a section is shown."""

    TABLE = "table"
    """Methods of one case, one under the other."""
    SERIES = "series"
    """Methods over the cases: K or R₀ on the axis."""
    DISTRIBUTION = "distribution"
    """Distribution of the error on one case."""
    RIVALS = "rivals"
    """A row a case: ``posterior`` beside the best other method."""


@dataclass(frozen=True, slots=True)
class Axis:
    """The axis of a series."""

    label: str
    """With its unit."""
    values: tuple[float, ...]
    """One a case."""


@dataclass(frozen=True, slots=True)
class Section:
    """Some methods on some cases, shown in one table and one plot."""

    key: str
    """Name of its plot's file within the study."""
    title: str
    """Heading."""
    cases: tuple[str, ...]
    """Names in ``CASES``."""
    methods: tuple[str, ...]
    """Names in ``METHODS``, ``centre``, ``adaptive-sound``."""
    shape: Shape = Shape.TABLE
    """How it is shown."""
    axis: Axis | None = None
    """Of a series."""
    note: str = ""
    """What a reader must know before comparing."""
    paper: str | None = None
    """Environment in the paper's Table IV whose figures may be set beside; None: none may."""
    paper_case: str | None = None
    """The case that those figures are of."""


@dataclass(frozen=True, slots=True)
class Study:
    """What ``sim-sitl study NAME`` computes and writes."""

    name: str
    """As on the command line."""
    title: str
    """Heading of the report."""
    sections: tuple[Section, ...]
    """In the report's order."""

    @property
    def methods(self) -> tuple[str, ...]:
        """Every method that any section runs."""
        return tuple(dict.fromkeys(name for section in self.sections for name in section.methods))

    def only(self, methods: Iterable[str]) -> Study:
        """The same study with no other methods; sections left without any go."""
        wanted = set(methods)
        sections = (
            replace(section, methods=tuple(name for name in section.methods if name in wanted))
            for section in self.sections
        )
        return replace(self, sections=tuple(section for section in sections if section.methods))


def runs_of(studies: Iterable[Study]) -> dict[str, tuple[str, ...]]:
    """Every case that the studies need, with all methods that any of them runs on it."""
    runs: dict[str, dict[str, None]] = {}
    for study in studies:
        for section in study.sections:
            for case in section.cases:
                runs.setdefault(case, {}).update(dict.fromkeys(section.methods))
    return {case: tuple(methods) for case, methods in runs.items()}
