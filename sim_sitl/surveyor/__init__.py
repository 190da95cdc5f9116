"""A lone surveyor: one UAV with an uncalibrated receiver looks for a transmitter on open ground.

Exists because a real search by received power alone (one vehicle, 200–300 m, ten minutes) fails by
what the swarm's world leaves out: antennas that are deaf overhead, a ground that reflects, an
airframe that shades, a receiver that loses lock and whose decibels have no zero. Rules: nothing here
follows the station's model of the radio; one seed gives one flight; frames say what a vehicle's do.

``survey`` says what a flight is made of, ``radio`` what is heard where, ``flight`` where it goes,
``recording`` writes it down.
"""

from sim_sitl.surveyor.flight import Flight, fly
from sim_sitl.surveyor.radio import Radio
from sim_sitl.surveyor.recording import BEACON_ID, ORIGIN, write_area, write_tlog
from sim_sitl.surveyor.survey import Survey, draw

__all__ = [
    "BEACON_ID", "ORIGIN", "Flight", "Radio", "Survey", "draw", "fly", "write_area", "write_tlog",
]  # fmt: skip
