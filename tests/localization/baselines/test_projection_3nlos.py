from __future__ import annotations

import numpy as np

from groundstation.localization import SignalModel
from groundstation.localization.baselines.projection_3nlos import projection_3nlos
from groundstation.localization.batch import Batch
from groundstation.localization.lsre_literal import lsre_socp_iterative
from groundstation.localization.rays import Rays

MODEL = SignalModel()


def test_it_is_the_nlos_links_own_answer_on_the_ray(draw) -> None:
    """Problems with two and with three NLOS links in one batch, each against its own sub-problem."""
    drawn = draw(20, (1, 0, 0, 0), 11)
    drawn.links.los_probability[:10, 3] = 1.0
    batch = Batch.of(drawn.links, drawn.area, MODEL)
    answers = projection_3nlos(batch)
    for row in range(20):
        one = batch.rows([row])
        free = lsre_socp_iterative(one.with_links(np.array([[1, 2] if row < 10 else [1, 2, 3]])))
        rays = Rays.of(one)
        expected = rays.at(rays.along_m(free.position_enu_m))
        assert np.allclose(answers.position_enu_m[row], expected[0])
        assert answers.transmit_power_dbm[row] == free.transmit_power_dbm[0]
        assert answers.path_loss_exponent[row, 0] == MODEL.los_exponent
        assert answers.path_loss_exponent[row, 1] == free.path_loss_exponent[0, 0]


def test_the_los_links_power_is_not_used(draw) -> None:
    drawn = draw(20, (1, 0, 0, 0, 0, 0), 12)
    before = projection_3nlos(Batch.of(drawn.links, drawn.area, MODEL)).position_enu_m
    drawn.links.rss_dbm[:, 0] -= 20.0
    after = projection_3nlos(Batch.of(drawn.links, drawn.area, MODEL)).position_enu_m
    assert (before == after).all()
