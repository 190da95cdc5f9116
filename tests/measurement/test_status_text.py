from groundstation.domain.events import Severity
from groundstation.mavlink.messages import StatusText
from groundstation.measurement.status_text import StatusTexts

S = 1_000_000_000


def test_severity_four_warns_three_and_worse_are_errors_the_rest_is_counted():
    texts = StatusTexts()
    assert texts.add(1, StatusText(3, "EKF failsafe", 0, 0), 0) == (Severity.ERROR, "EKF failsafe")
    assert texts.add(1, StatusText(4, "Low battery", 0, 0), 0) == (Severity.WARNING, "Low battery")
    assert texts.add(1, StatusText(6, "ArduPilot Ready", 0, 0), 0) is None
    assert texts.informational == 1


def test_a_repetition_is_held_back_for_a_minute():
    texts = StatusTexts()
    message = StatusText(2, "Arm: GPS", 0, 0)
    assert texts.add(1, message, 0) is not None
    assert texts.add(1, message, 30 * S) is None
    assert texts.add(1, message, 59 * S) is None
    assert texts.repeated == 2
    assert texts.add(1, message, 61 * S) is not None


def test_chunks_are_joined_in_order_whatever_order_they_came_in():
    texts = StatusTexts()
    assert texts.add(1, StatusText(3, "b" * 50, 7, 1), 0) is None
    assert texts.add(1, StatusText(3, "a" * 50, 7, 0), 0) is None
    found = texts.add(1, StatusText(3, "end", 7, 2), 0)
    assert found == (Severity.ERROR, "a" * 50 + "b" * 50 + "end")


def test_a_text_whose_end_never_comes_is_told_after_a_while_with_its_hole():
    texts = StatusTexts()
    texts.add(1, StatusText(3, "a" * 50, 7, 0), 0)
    texts.add(1, StatusText(3, "c" * 50, 7, 2), 0)
    assert texts.tick(S) == []
    assert texts.tick(2 * S) == [(Severity.ERROR, "a" * 50 + " … " + "c" * 50)]
    assert texts.tick(9 * S) == []


def test_control_characters_do_not_reach_the_page():
    assert StatusTexts().add(1, StatusText(3, "a\x1b[31m\nb", 0, 0), 0) == (Severity.ERROR, "a [31m b")


def test_partial_texts_are_bounded():
    texts = StatusTexts()
    for chunk in range(1, 100):
        texts.add(1, StatusText(3, "a" * 50, chunk, 0), 0)
    assert len(texts.state()["partials"]) == 8


def test_state_and_restore():
    one, two = StatusTexts(), StatusTexts()
    one.add(1, StatusText(3, "a" * 50, 7, 0), 0)
    one.add(1, StatusText(2, "said", 0, 0), 0)
    two.restore(one.state())
    assert two.add(1, StatusText(2, "said", 0, 0), S) is None
    assert two.tick(2 * S) == one.tick(2 * S) != []
