from __future__ import annotations

import numpy as np

from groundstation.localization import Links, SearchArea, SignalModel
from groundstation.localization.baselines import angle_reconstruction as module
from groundstation.localization.baselines.angle_reconstruction import angle_reconstruction
from groundstation.localization.baselines.nlos_part import nlos_part
from groundstation.localization.batch import Answers, Batch
from groundstation.localization.wls import wls_taylor

MODEL = SignalModel()


def test_consistent_angles_and_distances_give_the_place_back(monkeypatch) -> None:
    """Were the NLOS solution the truth, every row of WLS-Taylor would be exact."""
    truth = np.array([[30.0, -40.0, 8.0]])
    turn = 2.0 * np.pi * np.arange(5) / 5
    place = np.stack([100 * np.cos(turn), 100 * np.sin(turn), np.full(5, 50.0)], axis=1)[None]
    offset = truth[:, None] - place
    distance = np.linalg.norm(offset, axis=-1)
    azimuth = np.full((1, 5), np.nan)
    elevation = azimuth.copy()
    azimuth[0, 0] = np.arctan2(offset[0, 0, 1], offset[0, 0, 0])
    elevation[0, 0] = np.arcsin(offset[0, 0, 2] / distance[0, 0])
    rss = 14.0 - 10.0 * MODEL.los_exponent * np.log10(distance)
    batch = Batch.of(
        Links(place, rss, azimuth, elevation, np.array([[1.0, 0, 0, 0, 0]])),
        SearchArea(np.zeros(2), 100.0, 0.0, 20.0),
        MODEL,
    )
    exact = Answers.closed_form(batch, truth, np.array([14.0]), batch.first_exponents())
    monkeypatch.setattr(module, "nlos_part", lambda _: exact)
    assert np.allclose(angle_reconstruction(batch).position_enu_m, truth, atol=1e-6)


def test_it_is_wls_taylor_on_the_angles_of_the_nlos_solution(draw) -> None:
    """Made by hand with LOS labels and the powers that tell the estimated distances."""
    drawn = draw(25, (1, 0, 0, 0), 21)
    batch = Batch.of(drawn.links, drawn.area, MODEL)
    first = nlos_part(batch)
    offset = first.position_enu_m[:, None] - batch.place
    distance = np.linalg.norm(offset, axis=-1)
    distance[:, 0] = 10.0 ** ((first.transmit_power_dbm - batch.links.rss_dbm[:, 0]) / 25.0)
    azimuth = np.arctan2(offset[..., 1], offset[..., 0])
    elevation = np.arctan2(offset[..., 2], np.hypot(offset[..., 0], offset[..., 1]))
    azimuth[:, 0], elevation[:, 0] = batch.links.azimuth_rad[:, 0], batch.links.elevation_rad[:, 0]
    made = Links(batch.place, -25.0 * np.log10(distance), azimuth, elevation, np.ones((25, 4)))
    expected = wls_taylor(Batch.of(made, drawn.area, MODEL)).position_enu_m
    answers = angle_reconstruction(batch)
    assert np.allclose(answers.position_enu_m, expected, atol=1e-6)
    assert (answers.transmit_power_dbm == first.transmit_power_dbm).all()
