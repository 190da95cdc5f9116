"""The tracking study's files: the report, a row a case, method and time, a row a run, the pictures.

Rules: nothing that a clock gave is in the CSVs; every figure stands with its interval and
beside the exact filter's; a file is replaced whole or not at all.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from groundstation.store.snapshots import write_atomically
from sim_sitl.studies.report import interval, made_by, number, percent, ratio
from sim_sitl.studies.results import Provenance
from sim_sitl.studies.scoring import RESAMPLES, Figure
from sim_sitl.studies.tables import csv_text
from sim_sitl.studies.tables import number as cell
from sim_sitl.studies.tracking import plots
from sim_sitl.studies.tracking.answers import SHARES
from sim_sitl.studies.tracking.cases import CASES, SECTIONS, Case
from sim_sitl.studies.tracking.methods import EXACT, METHODS, OURS
from sim_sitl.studies.tracking.pieces import CaseResult
from sim_sitl.studies.tracking.scores import Score, share_figure

SHOWN_S = (0.0, 10.0, 30.0, 60.0, 120.0)
"""Times in the report's tables; the CSV has all."""
COVERED_S = (10.0, 30.0, 60.0, 120.0)
"""Times at which regions are judged."""
_NINETY = SHARES.index(0.9)
COLUMNS = (
    "case", "method", "time_s", "runs", "seed", "rmse_m", "rmse_low_m", "rmse_high_m", "rmse_horizontal_m",
    "rmse_horizontal_low_m", "rmse_horizontal_high_m", "median_m", "rmse_over_exact", "rmse_over_exact_low",
    "rmse_over_exact_high", "rmse_over_tracker", "rmse_over_tracker_low", "rmse_over_tracker_high",
    *(f"held_{round(100 * share)}{end}" for share in SHARES for end in ("", "_low", "_high")),
    *(f"held_drawn_{round(100 * share)}" for share in SHARES),
    *(f"area_{round(100 * share)}_m2" for share in SHARES), "worst_run", "worst_m",
)  # fmt: skip
RUN_COLUMNS = (
    "case", "run", "method", "time_s", "truth_east_m", "truth_north_m", "truth_up_m", "error_east_m",
    "error_north_m", "error_up_m", "level", "area_90_m2", "walking_probability",
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """All that the study found."""

    results: Mapping[str, CaseResult]
    """By case, in the study's order."""
    scores: Mapping[str, Sequence[Score]]
    """By case: methods in order, times in order."""
    provenance: Provenance
    """Of all of it."""

    def score(self, case: str, method: str, time_s: float) -> Score | None:
        """One row; None: there is none."""
        rows = self.scores.get(case, ())
        return next((row for row in rows if row.method == method and row.time_s == time_s), None)

    def methods(self, case: str) -> list[str]:
        """In their order."""
        return list(self.results[case].outcomes)


def write_report(found: Found, out: Path) -> list[Path]:
    """Write all files into the folder ``out``; returns their paths, the report first."""
    rows = [_row(found, score) for scores in found.scores.values() for score in scores]
    files: dict[str, bytes] = {
        "tracking.csv": csv_text(COLUMNS, rows).encode(),
        "tracking-runs.csv": csv_text(RUN_COLUMNS, _run_rows(found)).encode(),
    }
    made = f"{found.provenance.trials} runs, seed {found.provenance.seed}"
    for case in found.results:
        if len(CASES[case].times_s) > 1:
            files[f"tracking-{case}.png"] = plots.error_and_honesty(
                f"{CASES[case].title}\n{made}", found.scores[case], found.results[case], CASES[case].times_s
            )
    files["tracking.md"] = markdown(found).encode()
    for name, data in files.items():
        write_atomically(out / name, data)
    return [out / name for name in sorted(files, key=lambda name: (name != "tracking.md", name))]


def _row(found: Found, s: Score) -> list[object]:
    return [
        s.case, s.method, cell(s.time_s), s.runs, found.provenance.seed, *_three(s.rmse_m),
        *_three(s.rmse_horizontal_m), cell(s.median_m), *_three(s.exact_ratio), *_three(s.ours_ratio),
        *(value for figure in s.held for value in _three(figure)),
        *(cell(figure.value) for figure in s.held_drawn), *(cell(area) for area in s.area_m2),
        s.worst_run, cell(s.worst_m),
    ]  # fmt: skip


def _three(figure: Figure) -> tuple[str, str, str]:
    return cell(figure.value), cell(figure.low), cell(figure.high)


def _run_rows(found: Found) -> list[list[object]]:
    rows: list[list[object]] = []
    for name, result in found.results.items():
        for run, way in enumerate(result.truth_enu_m):
            for method, outcome in result.outcomes.items():
                for at, time_s in enumerate(CASES[name].times_s):
                    rows.append(
                        [
                            name, run, method, cell(time_s), *(cell(float(x)) for x in way[at]),
                            *(cell(float(x)) for x in outcome.error_enu_m[run, at]),
                            cell(float(outcome.level[run, at])),
                            cell(float(outcome.area_m2[run, at, _NINETY])),
                            cell(float(outcome.walking[run, at])),
                        ]
                    )  # fmt: skip
    return rows


def markdown(found: Found) -> str:
    """The report."""
    p = found.provenance
    lines = [
        "# Tracking",
        "",
        f"{p.trials} runs a case, seed {p.seed}; every method on the same runs, a window of each vehicle "
        "every second, all windows of a second at once. Brackets: 95 % interval, by bootstrap over runs "
        f"({RESAMPLES} resamples; paired for ratios), of shares Wilson's. RMSE is in three dimensions. "
        "A region's share is judged in the plane; honest is its own number.",
        "",
        "| method | what it is |",
        "|---|---|",
        *(
            f"| {name} | {what} |"
            for name, (_, what) in METHODS.items()
            if any(name in result.outcomes for result in found.results.values())
        ),
        "",
        *_in_short(found),
    ]
    for section, title in SECTIONS.items():
        cases = [CASES[name] for name in found.results if CASES[name].section == section]
        if cases:
            lines += [f"## {title}", ""]
            for case in cases:
                lines += _case(found, case)
    lines += _times(found)
    return "\n".join([*lines, *made_by(p)])


def _in_short(found: Found) -> list[str]:
    lines = [
        f"| case | at, s | exact, m | {OURS}, m | / exact | particles / {OURS} | least squares / {OURS} "
        "| truth in 90 % region | as drawn | its area, m² |",
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for name in found.results:
        times = [t for t in (60.0, 120.0) if t in CASES[name].times_s] or [CASES[name].times_s[-1]]
        for time_s in times:
            ours, exact = found.score(name, OURS, time_s), found.score(name, EXACT, time_s)
            peers = [found.score(name, peer, time_s) for peer in ("particles", "least-squares")]
            if ours is None:
                continue
            cells = (
                CASES[name].title,
                f"{time_s:g}",
                "–" if exact is None else number(exact.rmse_m.value),
                interval(ours.rmse_m),
                interval(ours.exact_ratio, ratio),
                *("–" if peer is None else interval(peer.ours_ratio, ratio) for peer in peers),
                _share(ours.held[_NINETY]),
                _share(ours.held_drawn[_NINETY]),
                f"{ours.area_m2[_NINETY]:.0f}",
            )
            lines.append("| " + " | ".join(cells) + " |")
    return [*lines, ""]


def _case(found: Found, case: Case) -> list[str]:
    shown = [time_s for time_s in SHOWN_S if time_s in case.times_s]
    head = " | ".join(f"{time_s:g} s" for time_s in shown)
    lines = [f"### {case.title}", "", f"`{case.name}`. {case.note}".rstrip(), ""]
    if case.limit_m is not None:
        lines += [f"What no estimator beats, over thousands of other trials: {case.limit_m:g} m.", ""]
    lines += [f"| RMSE, m | {head} |", "|---|" + "--:|" * len(shown)]
    for method in found.methods(case.name):
        cells = (_of(found.score(case.name, method, time_s), "rmse_m", number) for time_s in shown)
        lines.append(f"| {_named(method)} | {' | '.join(cells)} |")
    if EXACT in found.methods(case.name):
        lines += ["", f"| RMSE / exact | {head} |", "|---|" + "--:|" * len(shown)]
        for method in found.methods(case.name):
            if method not in (EXACT, "centre"):
                cells = (
                    _of(found.score(case.name, method, time_s), "exact_ratio", ratio) for time_s in shown
                )
                lines.append(f"| {_named(method)} | {' | '.join(cells)} |")
    judged = [time_s for time_s in COVERED_S if time_s in case.times_s] or list(shown)
    columns = [(time_s, place) for time_s in judged for place in range(len(SHARES))]
    lines += [
        "",
        "| truth in region of | " + " | ".join(f"{SHARES[i]:.0%}, {t:g} s" for t, i in columns) + " |",
        "|---|" + "--:|" * len(columns),
    ]
    for method in found.methods(case.name):
        if method == "centre":
            continue
        values = [(found.score(case.name, method, time_s), place) for time_s, place in columns]
        cells = ("–" if row is None else _share(row.held[place], place == _NINETY) for row, place in values)
        lines.append(f"| {_named(method)} | {' | '.join(cells)} |")
    ours = [(found.score(case.name, OURS, time_s), place) for time_s, place in columns]
    if any(row is not None for row, _ in ours):
        cells = ("–" if row is None else _share(row.held_drawn[place], False) for row, place in ours)
        lines.append(f"| {OURS}, as drawn | {' | '.join(cells)} |")
    lines += ["", "| area of the 90 % region, m² | " + head + " |", "|---|" + "--:|" * len(shown)]
    for method in found.methods(case.name):
        areas = [found.score(case.name, method, time_s) for time_s in shown]
        cells = ("–" if row is None else f"{row.area_m2[_NINETY]:.0f}" for row in areas)
        lines.append(f"| {_named(method)} | {' | '.join(cells)} |")
    lines += ["", *_walkers(found, case, judged), *_worst(found, case)]
    if len(case.times_s) > 1:
        lines += [f"![{case.title}](tracking-{case.name}.png)", ""]
    return lines


def _walkers(found: Found, case: Case, judged: Sequence[float]) -> list[str]:
    """How often the tracker took the person to walk."""
    outcome = found.results[case.name].outcomes.get(OURS)
    if outcome is None or (not case.world.walking_m_s and len(case.times_s) == 1):
        return []
    told = []
    for time_s in judged:
        walking = outcome.walking[:, case.times_s.index(time_s)]
        told.append(f"{_share(share_figure(float((walking >= 0.5).sum()), walking.size))} at {time_s:g} s")
    who = f"walks at {case.world.walking_m_s:g} m/s" if case.world.walking_m_s else "stands still"
    return [f"The person {who}; taken to walk (P ≥ 0.5): {', '.join(told)}.", ""]


def _worst(found: Found, case: Case) -> list[str]:
    """The worst run and what the others made of it: hard for all, or the tracker's own fault."""
    result = found.results[case.name]
    if OURS not in result.outcomes:
        return []
    at = len(case.times_s) - 1
    error = np.sqrt(result.outcomes[OURS].square_m2[:, at])
    run = int(np.argmax(error))
    truth = result.truth_enu_m[run, at]
    others = ", ".join(
        f"{name} {math.sqrt(float(outcome.square_m2[run, at])):.1f} m"
        for name, outcome in result.outcomes.items()
        if name not in (OURS, "centre")
    )
    level = result.outcomes[OURS].level[run, at]
    text = (
        f"Worst run of {OURS}: number {run}, {error[run]:.1f} m off after {case.times_s[at]:g} s; target at "
        f"({truth[0]:.0f}, {truth[1]:.0f}, {truth[2]:.0f}) m; credible level of the truth {level:.2f}"
    )
    lines = [text + (f"; on the same run: {others}." if others else "."), ""]
    if EXACT in result.outcomes:
        apart = error - np.sqrt(result.outcomes[EXACT].square_m2[:, at])
        run = int(np.argmax(apart))
        lines += [
            f"Furthest behind the exact filter: run {run}, {apart[run]:.1f} m more ({error[run]:.1f} m).",
            "",
        ]
    return lines


def _times(found: Found) -> list[str]:
    lines = [
        "## Where the time went",
        "",
        "Processor time a run, for orientation: the machine may be busy.",
        "",
        "| method | runs | s a run |",
        "|---|--:|--:|",
    ]
    for name in METHODS:
        spent = [result.outcomes[name].cpu_s for result in found.results.values() if name in result.outcomes]
        if spent:
            every = np.concatenate(spent)
            lines.append(f"| {name} | {every.size} | {every.mean():.3g} |")
    return [*lines, ""]


def _of(score: Score | None, name: str, form: Callable[[float], str]) -> str:
    return "–" if score is None else interval(getattr(score, name), form)


def _named(method: str) -> str:
    return f"**{method}**" if method in (OURS, EXACT) else method


def _share(figure: Figure, with_interval: bool = True) -> str:
    if math.isnan(figure.value):
        return "–"
    if not with_interval:
        return percent(figure.value)
    return f"{percent(figure.value)} [{100 * figure.low:.0f}, {100 * figure.high:.0f}]"
