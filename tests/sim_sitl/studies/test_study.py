"""The studies as data: every case and method is there, and the paper stands beside what it is of."""

from __future__ import annotations

import pytest

from groundstation.localization import METHODS
from sim_sitl.studies import paper
from sim_sitl.studies.cases import CASES
from sim_sitl.studies.chunks import ADAPTIVE, CENTRE
from sim_sitl.studies.commands import STUDIES
from sim_sitl.studies.hard import HARD
from sim_sitl.studies.study import Section, Shape, Study, runs_of
from sim_sitl.studies.table4 import TABLE4

SECTIONS = [
    pytest.param(study, section, id=f"{study.name}-{section.key}")
    for study in STUDIES.values()
    for section in study.sections
]


@pytest.mark.parametrize(("study", "section"), SECTIONS)
def test_every_section_names_cases_and_methods_that_exist(study: Study, section: Section) -> None:
    assert section.cases
    assert set(section.cases) <= set(CASES)
    assert set(section.methods) <= {*METHODS, *ADAPTIVE, CENTRE}
    assert "posterior" in section.methods
    assert CENTRE in section.methods
    assert len(set(section.methods)) == len(section.methods)
    if section.shape is Shape.SERIES:
        assert section.axis is not None
        assert len(section.axis.values) == len(section.cases)
        for case, value in zip(section.cases, section.axis.values, strict=True):
            shown = CASES[case].vehicles if "K" in section.axis.label else CASES[case].radius_m
            assert shown == value
    if section.paper is not None:
        assert section.paper_case in section.cases
        # What the paper measured is among what is run.
        assert set(paper.TABLE_IV[section.paper]) - {paper.LIMIT} <= set(section.methods)


def test_all_the_papers_tables_and_figures_are_there() -> None:
    assert set(STUDIES) == {"table4", *(f"fig{number}" for number in range(3, 11)), "hard"}


def test_the_papers_nlos_figures_never_stand_beside_equation_8() -> None:
    for study in STUDIES.values():
        for section in study.sections:
            if section.paper == "NLOS":
                assert all(case.startswith("nlos-rubble") for case in section.cases)


def test_table4_runs_every_method_there_is() -> None:
    assert set(TABLE4.methods) == {*METHODS, *ADAPTIVE, CENTRE}


def test_the_hard_cases_are_all_there_each_in_three_environments() -> None:
    cases = [case for section in HARD.sections for case in section.cases]
    assert sorted(cases) == sorted(name for name, case in CASES.items() if case.environment == "hard")
    for section in HARD.sections:
        assert "wls-ideal" not in section.methods, "it knows the truth: no rival"
        assert "lsre-socp" in section.methods, "the weighted centroid must be there to lose"


def test_the_ratio_that_the_paper_claims_follows_from_its_table() -> None:
    los = paper.TABLE_IV["LOS"]
    assert los["wls-taylor"].rmse_m / los[paper.LIMIT].rmse_m == pytest.approx(1.05, abs=0.005)


def test_a_study_of_fewer_methods_loses_sections_that_have_none_left() -> None:
    only = TABLE4.only(["wls-taylor"])
    assert [section.key for section in only.sections] == ["los"]
    assert only.methods == ("wls-taylor",)


def test_a_case_of_two_studies_is_run_once_with_the_methods_of_both() -> None:
    runs = runs_of([TABLE4.only(["wls-taylor"]), STUDIES["fig3"].only(["wls-taylor-bounded"])])
    assert runs["los-k4"] == ("wls-taylor", "wls-taylor-bounded")
    assert runs["los-k5"] == ("wls-taylor-bounded",)
