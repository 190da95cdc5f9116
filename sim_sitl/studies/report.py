"""A study's files: CSV for programs, Markdown for people, PNG in it; the profile beside them.

Rules: the results' CSV holds nothing that a clock gave, so that the same seed gives the same
file; every figure is beside the paper's (where one is comparable) and the limit's; a file is
replaced whole or not at all, and no other file is touched.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import numpy as np

from groundstation.localization.solvers import SOLVERS
from groundstation.store.snapshots import write_atomically
from sim_sitl.studies import paper, plots
from sim_sitl.studies.cases import CASES
from sim_sitl.studies.result_files import cases_of, cdf_csv, paper_figure, profile_csv, results_csv, stages_of
from sim_sitl.studies.results import LIMIT, Provenance, Results, limit_name
from sim_sitl.studies.scoring import EXCLUDED_ABOVE_M, REFERENCE, RESAMPLES, Figure, Score
from sim_sitl.studies.study import Section, Shape, Study


def write_report(study: Study, results: Results, out: Path) -> list[Path]:
    """Write all files of ``study`` into the folder ``out``; returns their paths, the report first."""
    files: dict[str, bytes] = {
        f"{study.name}.csv": results_csv(study, results).encode(),
        f"{study.name}-profile.csv": profile_csv(study, results).encode(),
    }
    for section in study.sections:
        files[_picture(study, section)] = _plot(section, results)
        if section.shape is Shape.DISTRIBUTION:
            files[f"{study.name}-{section.key}-cdf.csv"] = cdf_csv(section, results).encode()
    report = f"{study.name}.md"
    files[report] = markdown(study, results).encode()
    for name, data in files.items():
        write_atomically(out / name, data)
    return [out / name for name in sorted(files, key=lambda name: (name != report, name))]


def markdown(study: Study, results: Results) -> str:
    """The report."""
    p = results.provenance
    lines = [
        f"# {study.title}",
        "",
        f"{p.trials} trials a case, seed {p.seed}; every method and the limit on the same trials.",
        f"Brackets: 95 % bootstrap interval over trials ({RESAMPLES} resamples; paired for ratios).",
        "RMSE is in three dimensions. A trial without an answer counts as the area's centre and is listed"
        " under *no answer*; the paper's rule"
        f" drops it, and errors above {EXCLUDED_ABOVE_M:g} m, and stands apart.",
        "",
    ]
    lines += _in_short(study, results)
    for section in study.sections:
        lines += [f"## {section.title}", ""]
        if section.note:
            lines += [section.note, ""]
        lines += [*_TABLES[section.shape](section, results), ""]
        lines += [f"![{section.title}]({_picture(study, section)})", ""]
    lines += _profile(study, results)
    return "\n".join([*lines, *made_by(p)])


def _in_short(study: Study, results: Results) -> list[str]:
    tables = [section for section in study.sections if section.shape in (Shape.TABLE, Shape.DISTRIBUTION)]
    if len(tables) < 2:
        return []
    lines = [
        f"| section | limit, m | {REFERENCE}, m | / limit | truth in 90 % region | best other method |"
        " its RMSE, m |",
        "|---|--:|--:|--:|--:|---|--:|",
    ]
    for section in tables:
        case = section.cases[0]
        mine, limit = results.scores[case].get(REFERENCE), results.limit(case)
        best = best_other(results.rows(section, case))
        cells = (
            section.title,
            "–" if limit is None else number(limit.rmse_m.value),
            *_reference_cells(mine),
            "–" if mine is None else percent(mine.in_region),
            "–" if best is None else best.method,
            "–" if best is None else interval(best.rmse_m),
        )
        lines.append("| " + " | ".join(cells) + " |")
    return [*lines, ""]


def _reference_cells(mine: Score | None) -> tuple[str, str]:
    return ("–", "–") if mine is None else (interval(mine.rmse_m), interval(mine.limit_ratio, ratio))


def _table(section: Section, results: Results) -> list[str]:
    lines = []
    for case in section.cases:
        lines += [
            f"{CASES[case].title}. Limit: {limit_name(case)}.",
            "",
            "| method | paper, m | RMSE, m | RMSE / limit | horizontal, m | median, m | 90 %, m | no answer"
            " | paper's rule, m (dropped) | truth in 90 % region | in 90 % ellipse | ms a solve (paper) |",
            "|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|",
        ]
        lines += [_table_row(section, score) for score in results.rows(section, case)]
        if section.paper is not None:
            lines += ["", f"Times: the paper's {paper.TIMES}."]
    return lines


def _table_row(section: Section, score: Score) -> str:
    published = paper_figure(section, score)
    if score.method == LIMIT:
        paper_m = "–" if published is None else number(published.rmse_m)
        return f"| **limit** ({limit_name(score.case)}) | {paper_m} | {interval(score.rmse_m)} |" + " |" * 9
    paper_ms = "" if published is None or published.time_s is None else f" ({1e3 * published.time_s:.0f})"
    bold = "**" if score.method == REFERENCE else ""
    told = " (told the truth)" if score.method in IDEAL else ""
    cells = (
        f"{bold}{score.method}{bold}{told}",
        "–" if published is None else number(published.rmse_m),
        interval(score.rmse_m),
        interval(score.limit_ratio, ratio),
        number(score.rmse_horizontal_m),
        number(score.median_m),
        number(score.p90_m),
        str(score.failed),
        f"{number(score.rmse_kept_m.value)} ({score.excluded})",
        percent(score.in_region),
        percent(score.in_ellipse),
        f"{1e3 * score.cpu_s_per_solve:.3g}{paper_ms}",
    )
    return "| " + " | ".join(cells) + " |"


def _series(section: Section, results: Results) -> list[str]:
    assert section.axis is not None
    head = [f"{value:g}" for value in section.axis.values]
    lines = [
        f"RMSE, m [95 %], over {section.axis.label}:",
        "",
        f"| method | {' | '.join(head)} |",
        "|---|" + "--:|" * len(head),
    ]
    for method in (*section.methods, LIMIT):
        found = [results.scores[case].get(method) for case in section.cases]
        name = f"**limit** ({limit_name(section.cases[0])})" if method == LIMIT else method
        cells = (_series_cell(section, score) for score in found)
        lines.append(f"| {name} | {' | '.join(cells)} |")
    if any(results.limit(case) is not None for case in section.cases):
        lines += ["", f"RMSE / limit over {section.axis.label}:", "", lines[2], lines[3]]
        for method in section.methods:
            cells = (interval(results.scores[case][method].limit_ratio, ratio) for case in section.cases)
            lines.append(f"| {method} | {' | '.join(cells)} |")
    lines += ["", "Horizontal RMSE, median, failures and coverage of each point: see the CSV."]
    return lines


def _series_cell(section: Section, score: Score | None) -> str:
    if score is None:
        return "–"
    published = paper_figure(section, score)
    beside = "" if published is None else f"; paper {number(published.rmse_m)}"
    failed = f"; {score.failed} no answer" if score.failed else ""
    return f"{interval(score.rmse_m)}{beside}{failed}"


def _distribution(section: Section, results: Results) -> list[str]:
    return _table(section, results)


def _rivals(section: Section, results: Results) -> list[str]:
    lines = [
        f"| case | limit, m | {REFERENCE}, m | / limit | best other method | its RMSE, m |"
        f" {REFERENCE} / it | weighted centroid, m | centre, m | truth in 90 % region |",
        "|---|--:|--:|--:|---|--:|--:|--:|--:|--:|",
    ]
    for case in section.cases:
        scores, limit = results.scores[case], results.limit(case)
        mine = scores.get(REFERENCE)
        best = best_other(results.rows(section, case))
        cells = (
            CASES[case].title,
            "–" if limit is None else number(limit.rmse_m.value),
            *_reference_cells(mine),
            "–" if best is None else best.method + (f" ({best.failed} no answer)" if best.failed else ""),
            "–" if best is None else interval(best.rmse_m),
            "–" if best is None else interval(best.reference_ratio, ratio),
            _rmse(scores, "lsre-socp"),
            _rmse(scores, "centre"),
            "–" if mine is None else percent(mine.in_region),
        )
        lines.append("| " + " | ".join(cells) + " |")
    return lines


IDEAL = frozenset(name for name, method in SOLVERS.items() if method.known_power)
"""Methods that are told what only the truth knows: references, no rivals."""


def best_other(scores: Iterable[Score]) -> Score | None:
    """The least RMSE of all but ``posterior``, the limit, what is told the truth and what never answered."""
    none = {REFERENCE, LIMIT, *IDEAL}
    others = [score for score in scores if score.method not in none and score.failed < score.trials]
    return min(others, key=lambda score: score.rmse_m.value, default=None)


def _rmse(scores: Mapping[str, Score], method: str) -> str:
    score = scores.get(method)
    if score is None:
        return "–"
    return number(score.rmse_m.value) + (f" ({score.failed} no answer)" if score.failed else "")


_TABLES = {
    Shape.TABLE: _table,
    Shape.SERIES: _series,
    Shape.DISTRIBUTION: _distribution,
    Shape.RIVALS: _rivals,
}


def _profile(study: Study, results: Results) -> list[str]:
    total: dict[str, float] = {}
    solves: dict[str, int] = {}
    for case in cases_of(study):
        for name, seconds in stages_of(study, results, case).items():
            total[name] = total.get(name, 0.0) + seconds
            solves[name] = solves.get(name, 0) + results.provenance.trials
    everything = sum(total.values()) or math.nan
    lines = [
        "## Where the time went",
        "",
        f"{everything:.1f} s of processor time over all workers; for orientation, the machine may be busy.",
        "",
        "| stage | processor time, s | share | ms a trial |",
        "|---|--:|--:|--:|",
    ]
    for name, seconds in sorted(total.items(), key=lambda item: -item[1]):
        share = percent(seconds / everything)
        lines.append(f"| {name} | {seconds:.2f} | {share} | {1e3 * seconds / solves[name]:.3g} |")
    return [*lines, ""]


def made_by(origin: Provenance) -> list[str]:
    """A report's last lines: what to type to have it again, and what it was made with."""
    versions = ", ".join(f"{name} {version}" for name, version in origin.versions.items())
    return [
        "## Made by",
        "",
        f"`{origin.command}`",
        "",
        f"{origin.workers}; {origin.wall_s:.0f} s in all. {versions}.",
        "",
    ]


def number(value: float) -> str:
    """Metres as people read them: four figures at most."""
    if math.isnan(value):
        return "–"
    return f"{value:.3f}" if abs(value) < 10.0 else f"{value:.1f}" if abs(value) < 1e4 else f"{value:.3g}"


def ratio(value: float) -> str:
    """A ratio with three decimals, fewer where it is large."""
    return "–" if math.isnan(value) else f"{value:.3f}" if abs(value) < 10.0 else f"{value:.1f}"


def interval(figure: Figure, form: Callable[[float], str] = number) -> str:
    """``2.331 [2.29, 2.37]``."""
    if math.isnan(figure.value):
        return "–"
    if math.isnan(figure.low):
        return form(figure.value)
    return f"{form(figure.value)} [{form(figure.low)}, {form(figure.high)}]"


def percent(share: float) -> str:
    """``90.1 %``."""
    return "–" if math.isnan(share) else f"{100.0 * share:.1f} %"


# ── pictures ──────────────────────────────────────────────────────────────────────────────────


def _picture(study: Study, section: Section) -> str:
    return f"{study.name}-{section.key}.png"


def _plot(section: Section, results: Results) -> bytes:
    first = section.cases[0]
    made = f"{results.provenance.trials} trials a case, seed {results.provenance.seed}"
    title = f"{section.title}\n{made}"
    published = {} if section.paper is None else paper.TABLE_IV[section.paper]
    paper_m = {name: figure.rmse_m for name, figure in published.items() if name in section.methods}
    if section.shape is Shape.TABLE:
        scores = [results.scores[first][name] for name in section.methods]
        return plots.dots(
            f"{CASES[first].title}\n{made}", scores, results.limit(first), limit_name(first), paper_m
        )
    if section.shape is Shape.SERIES:
        assert section.axis is not None
        rows = {name: [results.scores[case][name] for case in section.cases] for name in section.methods}
        limits = [limit for case in section.cases if (limit := results.limit(case)) is not None]
        complete = limits if len(limits) == len(section.cases) else []
        at = None
        if section.paper_case is not None:
            at = section.axis.values[section.cases.index(section.paper_case)]
        return plots.series(title, section.axis, rows, complete, limit_name(first), paper_m, at)
    outcomes = results.chunks[first].outcomes
    if section.shape is Shape.DISTRIBUTION:
        square = results.chunks[first].limit_square_m2
        # Of a Cramér–Rao bound the root is no error that any trial had.
        limit_m = np.sqrt(square) if limit_name(first) != "CRLB" and results.limit(first) else None
        chosen = {name: outcomes[name] for name in section.methods}
        return plots.distribution(title, chosen, limit_m, limit_name(first))
    return plots.rivals(title, {CASES[case].title: results.rows(section, case) for case in section.cases})
