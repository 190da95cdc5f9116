from groundstation.domain.events import Counter
from groundstation.measurement.tally import Tally


def test_totals_by_name_and_label_in_a_fixed_order():
    tally = Tally()
    tally.add("b_total", "vehicle=2")
    tally.add("b_total", "vehicle=1", 3)
    tally.add("a_total")
    assert tally.counters() == [
        Counter("a_total", (), 1),
        Counter("b_total", (("vehicle", "1"),), 3),
        Counter("b_total", (("vehicle", "2"),), 1),
    ]
    assert tally.total("b_total") == 4


def test_state_and_restore():
    one, two = Tally(), Tally()
    one.add("a_total", "kind=x", 5)
    two.restore(one.state())
    two.add("a_total", "kind=x")
    assert two.total("a_total") == 6
