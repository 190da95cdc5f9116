from __future__ import annotations

import numpy as np
import pytest

from groundstation.domain.errors import InputError
from groundstation.localization import SignalModel
from groundstation.localization.batch import Answers, Batch
from groundstation.localization.methods import Method, refusals, solve


def centre(batch: Batch) -> Answers:
    """A method that answers the origin, and fails on anything that it should not have been given."""
    assert np.isfinite(batch.place).all()
    size, links = batch.size, batch.links.count
    return Answers.closed_form(batch, np.zeros((size, 3)), np.zeros(size), np.ones((size, links)))


@pytest.fixture
def batch(draw) -> Batch:
    drawn = draw(3, (1, 1, 0, 0), 81)
    return Batch.of(drawn.links, drawn.area, SignalModel())


@pytest.mark.parametrize(
    ("needs", "message"),
    [
        ({"links": 5}, "x got 4 link(s); it needs 5 or more"),
        ({"bearings": 3}, "x got 2 line-of-sight link(s) with angles; it needs 3 or more"),
        ({"nlos_links": 3}, "x got 2 link(s) labelled NLOS; it needs 3 or more"),
        ({"nlos_bearings": 1}, "x got 0 link(s) labelled NLOS with angles; it needs 1 or more"),
    ],
)
def test_each_need_is_told(batch: Batch, needs: dict[str, int], message: str) -> None:
    assert refusals("x", Method(centre, "", **needs), batch) == [message] * 3
    met = {name: number - 1 for name, number in needs.items()}
    assert refusals("x", Method(centre, "", **met), batch) == [""] * 3


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("position_enu_m", np.nan, "vehicle position of link 2 is not finite; ENU metres are needed"),
        ("position_enu_m", np.inf, "vehicle position of link 2 is not finite; ENU metres are needed"),
        ("rss_dbm", -np.inf, "received power of link 2 is not finite; dBm is needed"),
        ("los_probability", -0.1, "P(line of sight) of link 2 is -0.1; 0 to 1 is needed"),
        ("los_probability", 1.5, "P(line of sight) of link 2 is 1.5; 0 to 1 is needed"),
    ],
)
def test_each_nonsense_is_told_of_its_problem_alone(
    batch: Batch, name: str, value: float, message: str
) -> None:
    getattr(batch.links, name)[1, 2] = value
    answers = solve("x", Method(centre, "", links=2), batch)
    assert list(answers.status) == ["ok", message, "ok"]
    assert np.isfinite(answers.position_enu_m).all(axis=1).tolist() == [True, False, True]


def test_vehicles_in_one_place_tell_nothing_unless_one_is_enough(batch: Batch) -> None:
    batch.links.position_enu_m[0] = [[5.0, 5.0, 50.0], [5.5, 5.0, 50.0], [5.0, 5.4, 50.0], [5.0, 5.0, 49.5]]
    messages = refusals("x", Method(centre, "", links=2), batch)
    assert messages[0] == "all 4 vehicles are within 0.50 m of one place; x needs two or more places"
    assert messages[1:] == ["", ""]
    assert refusals("x", Method(centre, "", links=1), batch) == [""] * 3


def test_unknown_probability_is_no_nonsense(batch: Batch) -> None:
    batch.links.los_probability[0] = np.nan
    assert refusals("x", Method(centre, ""), batch) == [""] * 3
    assert refusals("x", Method(centre, "", bearings=1), batch)[0].startswith("x got 0 line-of-sight")


def test_a_power_that_nobody_knows_is_asked_for_once(batch: Batch) -> None:
    with pytest.raises(InputError, match="x got no transmit power; it needs the true one"):
        refusals("x", Method(centre, "", known_power=True), batch)


def test_needs_in_words() -> None:
    method = Method(centre, "", links=3, bearings=1, nlos_links=2, known_power=True)
    assert method.needs() == "3 links, 1 LOS with angles, 2 NLOS, transmit power"
    assert Method(centre, "").needs() == "1 link"
