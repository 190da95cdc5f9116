"""A real MAVSDK client flies a simulated vehicle, over UDP."""

from __future__ import annotations

import asyncio
import math
import socket
from typing import Any

import pytest
from mavsdk import Configuration
from mavsdk.asyncio.mavsdk import Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync

from groundstation.domain.geometry import distance_m
from sim_sitl.endpoints import parse_link
from sim_sitl.modes import Flavour
from sim_sitl.simulation import SimulationSettings
from sim_sitl.swarm import Swarm, SwarmOptions

pytestmark = [pytest.mark.peer, pytest.mark.timeout(60)]


@pytest.fixture
def port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@pytest.mark.parametrize("flavour", list(Flavour))
async def test_goto_location_and_hold(field: Any, port: int, flavour: Flavour, eventually: Any) -> None:
    options = SwarmOptions(
        field,
        parse_link(f"udpout:127.0.0.1:{port}", ("udpout",)),
        vehicles=1,
        speedup=4.0,
        simulation=SimulationSettings(flavour=flavour),
    )
    swarm = Swarm(options)
    vehicle = swarm.simulation.vehicles[1]
    running = asyncio.create_task(swarm.run())
    client = Mavsdk(Configuration.create_manual(245, 190, True))
    try:
        await client.add_any_connection(f"udpin://127.0.0.1:{port}")
        system = await client.first_autopilot(10.0)
        assert system is not None
        place = field.frame.to_geodetic((20.0, -30.0, 45.0))
        action = ActionAsync(system)
        await action.goto_location(place.latitude_deg, place.longitude_deg, place.altitude_amsl_m, math.nan)
        await eventually(lambda: distance_m(vehicle.flight.position_enu_m, (20.0, -30.0, 45.0)) < 1.0)
        assert vehicle.mode == ("GUIDED" if flavour is Flavour.ARDUPILOT else "AUTO.LOITER")
    finally:
        swarm.stop()
        await running
        client.destroy()
