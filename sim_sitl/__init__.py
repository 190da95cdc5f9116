"""A simulated swarm that hears simulated beacons, spoken to only by MAVLink.

Nothing here shares code with the station's signal models: what the station believes about
radio is checked against this, so the two must be able to disagree.
"""
