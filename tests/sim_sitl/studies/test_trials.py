import numpy as np

from groundstation.localization import Links, SearchArea, SignalModel
from sim_sitl.studies.trials import Trials


def test_rows_selects_every_column_of_the_same_trials():
    place = np.arange(24.0).reshape(4, 2, 3)
    numbers = np.arange(8.0).reshape(4, 2)
    trials = Trials(
        Links(place, numbers, numbers, numbers, numbers / 8.0),
        np.arange(12.0).reshape(4, 3),
        SearchArea(np.zeros(2), 100.0, 1.0, 20.0),
        SignalModel(),
        np.arange(4.0),
        np.arange(4.0) + 6.0,
        numbers > 3.0,
    )
    chosen = trials.rows(np.array([3, 1]))
    assert trials.count == 4
    assert chosen.count == 2
    assert chosen.truth_enu_m.tolist() == [[9.0, 10.0, 11.0], [3.0, 4.0, 5.0]]
    assert chosen.links.rss_dbm.tolist() == [[6.0, 7.0], [2.0, 3.0]]
    assert chosen.links.position_enu_m[0, 0].tolist() == [18.0, 19.0, 20.0]
    assert chosen.transmit_power_dbm.tolist() == [3.0, 1.0]
    assert chosen.bias_max_db.tolist() == [9.0, 7.0]
    assert chosen.line_of_sight.tolist() == [[True, True], [False, False]]
    assert chosen.area is trials.area
