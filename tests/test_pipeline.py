"""Rules of the composition that need no radio."""

from __future__ import annotations

from dataclasses import replace

from groundstation.command.desk import CommandDesk
from groundstation.domain.geometry import Geodetic
from groundstation.domain.inputs import DropInput, JoinInput, MissionInput, Record, SessionInput, TickInput
from groundstation.domain.mission import Mission
from groundstation.domain.vehicle import Autopilot, VehicleState
from groundstation.engine.ingest import Ingest
from groundstation.mission_files import disc_area
from groundstation.pipeline import Pipeline, dropped_windows, mission_with_origin, mission_with_settings

HOME = Geodetic(-35.3625, 149.1654, 584.0)


def vehicle(**changes: object) -> VehicleState:
    plain = VehicleState(
        vehicle_id=1, time_ns=0, connections=("a",), autopilot=Autopilot.ARDUPILOT, mode="GUIDED", armed=True,
        ready=True, lost=False, last_heartbeat_ns=0, position=None, position_time_ns=None,
        height_above_home_m=None, home=None, attitude=None, velocity_ned_m_s=None, battery_percent=None,
        battery_voltage_v=None, gps_fix_type=None, satellites=None, position_target=None,
        sensor_heard_ns=None, packet_loss_percent=None, clock_offset_known=False,
    )  # fmt: skip
    return replace(plain, **changes)  # type: ignore[arg-type]


def test_the_first_valid_home_is_the_origin_and_the_ground() -> None:
    mission = mission_with_origin(Mission(revision=3), vehicle(home=HOME))
    assert mission is not None
    assert (mission.revision, mission.origin, mission.ground_amsl_m) == (4, HOME, 584.0)
    assert mission.height_reference == "home"
    assert mission_with_origin(mission, vehicle(home=replace(HOME, latitude_deg=-35.0))) is None


def test_without_a_home_the_first_position_less_its_height_serves() -> None:
    flying = replace(HOME, altitude_amsl_m=634.0)
    assert mission_with_origin(Mission(), vehicle()) is None
    assert mission_with_origin(Mission(), vehicle(position=flying)) is None
    mission = mission_with_origin(Mission(), vehicle(position=flying, height_above_home_m=50.0))
    assert mission is not None
    assert mission.origin == HOME


def test_a_ground_from_the_settings_is_kept() -> None:
    given = Mission(ground_amsl_m=570.0, height_reference="settings")
    mission = mission_with_origin(given, vehicle(home=HOME))
    assert mission is not None
    assert (mission.ground_amsl_m, mission.height_reference) == (570.0, "settings")


def test_a_recording_without_an_area_gets_a_disc_round_the_first_place() -> None:
    mission = mission_with_origin(Mission(), vehicle(home=HOME), lambda place: disc_area(place, 500.0))
    assert mission is not None
    assert mission.search_area is not None
    assert mission_with_origin(mission, vehicle(home=HOME), lambda place: disc_area(place, 500.0)) is None


def test_a_run_s_settings_come_over_the_session_s_mission_and_what_they_lack_is_kept() -> None:
    fence, area = disc_area(HOME, 900.0), disc_area(HOME, 300.0)
    known = Mission(
        revision=4, origin=HOME, fence=fence, ground_amsl_m=584.0, height_reference="home",
        target_height_max_m=20.0,
    )  # fmt: skip
    merged = mission_with_settings(known, Mission(search_area=area, target_height_max_m=9.0))
    assert merged == replace(known, revision=5, search_area=area, target_height_max_m=9.0)
    measured = mission_with_settings(known, Mission(ground_amsl_m=570.0, height_reference="settings"))
    assert measured is not None
    assert (measured.ground_amsl_m, measured.height_reference, measured.fence) == (570.0, "settings", fence)


def test_settings_that_change_nothing_make_no_revision_but_the_first() -> None:
    assert mission_with_settings(Mission(revision=3, origin=HOME), Mission()) is None
    assert mission_with_settings(Mission(), Mission()) == Mission(revision=1)


def test_missions_ticks_joins_and_session_events_reach_the_estimator_in_order() -> None:
    pipeline = Pipeline(Ingest(), CommandDesk(replay=True))
    inputs = [
        SessionInput("began", "0"),
        MissionInput(Mission(1, HOME), "test"),
        TickInput(),
        JoinInput("ann", 8, 7),
    ]
    steps = [pipeline.handle(Record(seq, seq, 0, entry)) for seq, entry in enumerate(inputs)]
    assert [[work.item for work in step.work] for step in steps] == [[entry] for entry in inputs]
    assert pipeline.mission.origin == HOME


def test_dropped_windows_are_gathered_from_the_whole_journal() -> None:
    records = [
        Record(0, 0, 0, DropInput("estimator", ((1, 7, 10), (2, 7, 11)))),
        Record(1, 1, 0, TickInput()),
        Record(2, 2, 0, DropInput("estimator", ((1, 7, 30),))),
    ]
    assert dropped_windows(records) == {(1, 7, 10), (2, 7, 11), (1, 7, 30)}
