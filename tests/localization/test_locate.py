from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from groundstation.domain.errors import InputError
from groundstation.localization import METHODS, Links, SearchArea, SignalModel, locate, locate_batch
from groundstation.localization.batch import Batch
from groundstation.localization.locate import answer_batch, method_named
from groundstation.localization.solvers import SOLVERS

INTERFACE = (
    "wls-taylor", "wls-taylor-bounded", "wls-ideal", "sdp-socp", "sr-wls", "rwls-sdp", "lsre-sdp",
    "lsre-sdp-iterative", "lsre-socp", "lsre-socp-iterative", "lsre-ccp", "1aoa-nrss", "projection-3nlos",
    "angle-reconstruction", "projection-label-aware", "projection-label-aware-literal", "adaptive",
    "posterior",
)  # fmt: skip
TURNED_M = {
    "posterior": 1.5, "lsre-sdp": 1.0, "lsre-sdp-iterative": 1.0, "lsre-ccp": 1.0, "rwls-sdp": 5.0,
}  # fmt: skip
"""A mesh of squares does not turn; a flat optimum is met to a tolerance, and a rounding may end an
iteration a round earlier. A method that cared for the axes would be tens of metres off."""
KNOWN = SignalModel(known_transmit_power_dbm=15.0)
UNKNOWN = SignalModel()


def model_for(method: str) -> SignalModel:
    return KNOWN if method != "adaptive" and SOLVERS[method].known_power else UNKNOWN


def with_nlos_angles(drawn, seed: int) -> Links:
    """NLOS links report an angle drawn uniformly, as a real array would."""
    links, rng = drawn.links, np.random.default_rng(seed)
    shape = links.azimuth_rad.shape
    return Links(
        links.position_enu_m,
        links.rss_dbm,
        np.where(links.has_angle(), links.azimuth_rad, rng.uniform(-np.pi, np.pi, shape)),
        np.where(links.has_angle(), links.elevation_rad, rng.uniform(-1.5, 0.0, shape)),
        links.los_probability,
    )


def test_methods_are_the_interface_s() -> None:
    assert METHODS == INTERFACE


@pytest.mark.parametrize("method", METHODS)
def test_every_method_fills_its_estimate(draw, method: str) -> None:
    drawn = draw(3, (1, 1, 0, 0, 0), 52)
    ticks = itertools.count()
    found = locate_batch(
        with_nlos_angles(drawn, 52), drawn.area, method, model_for(method), clock=lambda: float(next(ticks))
    )
    for estimate in found:
        assert np.isfinite(estimate.position_enu_m).all()
        assert np.allclose(estimate.covariance_m2, estimate.covariance_m2.T)
        assert (np.linalg.eigvalsh(estimate.covariance_m2) > 1e-4).all()
        assert estimate.path_loss_exponent.shape == (5,)
        assert estimate.status.startswith(("ok", "iteration limit", "diverging"))
        assert np.isfinite(estimate.transmit_power_dbm) == (method != "1aoa-nrss")
        assert np.isfinite(estimate.rss_cost_db2) == (method != "1aoa-nrss")
        assert estimate.iterations >= 1
        assert estimate.method == ("wls-taylor" if method == "adaptive" else method)
        assert estimate.solve_time_s == pytest.approx(1 / 3)


@pytest.mark.parametrize("method", METHODS)
def test_a_batch_is_the_loop(draw, method: str) -> None:
    drawn = draw(5, (1, 1, 1, 0, 0), 53)
    links = with_nlos_angles(drawn, 53)
    # The same set of labels must not hold for the whole batch.
    links.los_probability[3:, 2] = 0.0
    model = model_for(method)
    bias = np.linspace(6.0, 8.0, 5)
    tolerance_m = 1e-3
    for index, estimate in enumerate(
        locate_batch(links, drawn.area, method, model, covariance=False, bias_max_db=bias)
    ):
        alone = locate_batch(
            links.subset([index]), drawn.area, method, model, covariance=False, bias_max_db=bias[[index]]
        )[0]
        assert np.allclose(alone.position_enu_m, estimate.position_enu_m, atol=tolerance_m)
        assert alone.transmit_power_dbm == pytest.approx(estimate.transmit_power_dbm, abs=0.02, nan_ok=True)
        assert alone.environment is estimate.environment
        assert alone.status == estimate.status


def place_of(links: Links, area: SearchArea, method: str) -> np.ndarray:
    return locate(links, area, method, model_for(method), covariance=False).position_enu_m


@pytest.mark.parametrize("method", METHODS)
@settings(max_examples=4, derandomize=True, deadline=None, phases=(Phase.generate,))
@given(
    turn_rad=st.floats(-np.pi, np.pi),
    shift=st.tuples(*[st.floats(-5000.0, 5000.0)] * 2),
    up_m=st.floats(-100.0, 2000.0),
    order=st.permutations(range(5)),
    seed=st.integers(0, 50),
)
def test_a_turned_and_moved_problem_has_the_turned_and_moved_answer(
    draw, method: str, turn_rad: float, shift: tuple[float, float], up_m: float, order: list[int], seed: int
) -> None:
    """Rotation about the vertical, translation, and another order of links: no method may care."""
    drawn = draw(1, (1, 1, 0, 0, 0), seed)
    links = with_nlos_angles(drawn, seed).problem(0)
    links.los_probability[:] = [0.97, 0.93, 0.04, 0.03, 0.02]
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    offset = np.array([*shift, up_m])
    moved = Links(
        links.position_enu_m @ rotation.T + offset,
        links.rss_dbm,
        links.azimuth_rad + turn_rad,
        links.elevation_rad,
        links.los_probability,
    ).subset(np.array(order))
    area = drawn.area
    there = SearchArea(offset[:2], area.radius_m, area.height_min_m + up_m, area.height_max_m + up_m)
    expected = rotation @ place_of(links, area, method) + offset
    assert np.linalg.norm(place_of(moved, there, method) - expected) < TURNED_M.get(method, 0.01)


def test_unknown_methods_are_told_what_there_is(draw) -> None:
    drawn = draw(1, (0, 0, 0, 0), 54)
    links = drawn.links.problem(0)
    with pytest.raises(InputError, match=r"did you mean 'sdp-socp'\? there are: wls-taylor, .*posterior"):
        locate(links, drawn.area, "sdp-soc")
    with pytest.raises(InputError, match=r"unknown method '.*'; there are: "):
        locate(links, drawn.area, "∅")
    assert method_named("lsre-ccp").links == 3


def test_what_is_missing_is_said(draw) -> None:
    drawn = draw(1, (0, 0, 0, 0), 54)
    links = drawn.links.problem(0)
    with pytest.raises(InputError, match=r"got 0 line-of-sight link\(s\) with angles; it needs 1 or more"):
        locate(links, drawn.area, "projection-label-aware")
    with pytest.raises(InputError, match="got no transmit power; it needs the true one"):
        locate(links, drawn.area, "wls-ideal")
    with pytest.raises(InputError, match=r"\(N, K, 3\) is needed"):
        locate_batch(links, drawn.area)
    with pytest.raises(InputError, match=r"\(K, 3\) is needed \(locate_batch"):
        locate(drawn.links, drawn.area)
    with pytest.raises(InputError, match=r"b_max has shape \(3,\); \(1,\) is needed"):
        locate_batch(drawn.links, drawn.area, bias_max_db=np.ones(3))


def test_of_many_the_first_that_fails_is_named_or_each_is_marked(draw) -> None:
    drawn = draw(4, (1, 1, 0, 0), 60)
    drawn.links.rss_dbm[2, 1] = np.nan
    with pytest.raises(InputError, match="problem 2: received power of link 1 is not finite; dBm is needed"):
        locate_batch(drawn.links, drawn.area, "wls-taylor")
    found = locate_batch(drawn.links, drawn.area, "wls-taylor", on_error="status")
    assert [np.isfinite(estimate.position_enu_m).all() for estimate in found] == [True, True, False, True]
    assert np.isnan(found[2].covariance_m2).all()
    assert found[2].status == "received power of link 1 is not finite; dBm is needed"
    clean = locate_batch(drawn.links.subset([0, 1, 3]), drawn.area, "wls-taylor")
    for one, other in zip([found[0], found[1], found[3]], clean, strict=True):
        assert np.allclose(one.position_enu_m, other.position_enu_m)


def test_covariance_is_left_out_on_request(draw) -> None:
    drawn = draw(2, (1, 0, 0, 0), 61)
    without, _ = locate_batch(drawn.links, drawn.area, "projection-label-aware", covariance=False)
    assert np.isnan(without.covariance_m2).all()
    with_one, _ = locate_batch(drawn.links, drawn.area, "projection-label-aware")
    assert np.isfinite(with_one.covariance_m2).all()
    assert np.array_equal(with_one.position_enu_m, without.position_enu_m)


def test_spread_about_an_answer_is_the_belief_s_and_its_distance(draw) -> None:
    drawn = draw(1, (0, 0, 0, 0), 62)
    links = drawn.links.problem(0)
    belief = locate(links, drawn.area, "posterior")
    other = locate(links, drawn.area, "lsre-socp")
    gap = other.position_enu_m - belief.position_enu_m
    assert np.allclose(other.covariance_m2, belief.covariance_m2 + np.outer(gap, gap))
    assert belief.belief is not None
    assert other.belief is None


def test_an_empty_batch_has_no_answers(draw) -> None:
    drawn = draw(1, (1, 1, 0, 0), 63)
    nothing = drawn.links.subset(np.arange(0))
    for method in METHODS:
        assert locate_batch(nothing, drawn.area, method, model_for(method)) == []


def test_arrays_for_studies_are_the_estimates(draw) -> None:
    drawn = draw(5, (1, 0, 0, 0), 64)
    batch = Batch.of(drawn.links, drawn.area, UNKNOWN)
    answers, names = answer_batch(batch, "adaptive")
    found = locate_batch(drawn.links, drawn.area, covariance=False)
    assert names == [estimate.method for estimate in found]
    assert np.array_equal(answers.position_enu_m, [estimate.position_enu_m for estimate in found])
