"""What the page asks for becomes an input of the station, journalled like all others."""

from __future__ import annotations

from groundstation.domain.inputs import AnyInput, JoinInput
from groundstation.operator_actions import OperatorActions
from groundstation.pipeline import Step


class Taking:
    """Takes inputs down."""

    def __init__(self) -> None:
        self.taken: list[AnyInput] = []

    def take(self, entry: AnyInput) -> Step:
        self.taken.append(entry)
        return Step((), (), (), ())


async def test_ids_are_joined_and_separated_by_an_input_that_names_who_said_so() -> None:
    station = Taking()
    actions = OperatorActions(station)
    joined = await actions.join(8, 7, "page@10.0.0.2")
    apart = await actions.separate(8, "page@10.0.0.3")
    assert station.taken == [JoinInput("page@10.0.0.2", 8, 7), JoinInput("page@10.0.0.3", 8, None)]
    assert (joined.accepted, apart.accepted) == (True, True)
    assert "8" in joined.text
    assert "7" in joined.text


async def test_a_hold_of_nobody_is_no_success() -> None:
    answer = await OperatorActions(Taking()).hold_all("page")
    assert (answer.accepted, answer.text) == (False, "nothing was done")
