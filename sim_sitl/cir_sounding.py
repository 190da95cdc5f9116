"""The impulse responses of one link as its sensor captures them, along the vehicle's flight.

Keeps the rule that a link has one channel that evolves as the vehicle moves and is redrawn
when the obstruction begins or ends: captures a metre apart look alike.
"""

from __future__ import annotations

import math

import numpy as np

from groundstation.domain.geometry import Enu
from sim_sitl.cir import ClusterChannel, Sounder, draw_channel
from sim_sitl.cir_encoding import (
    MAX_DATA_BYTES,
    TUNNEL_DATA_BYTES,
    CirEncoding,
    SarCirFields,
    encode_capture,
    window_round_first_path,
)
from sim_sitl.propagation import THERMAL_NOISE_DBM_HZ, Reception
from sim_sitl.randomness import Stream, generator

ACCUMULATION_GAIN_DB = 30.0
"""A sounder adds up about a thousand preamble symbols."""
SNR_MAX_DB = 40.0
"""What converters and clock jitter leave of a strong one."""
FIRST_PATH_JITTER_TAPS = 0.5
"""The first path falls anywhere within a tap."""
INDEX_NOISE_TAPS = 0.3
"""Standard deviation of the sensor's own first-path detection."""
REDRAW_DISTANCE_M = 40.0
"""Clusters (which do not move) are redrawn after so much flight."""


class LinkSounder:
    """Captures of one link."""

    def __init__(
        self, seed: int, vehicle_id: int, beacon_key: int, frequency_hz: int, sounder: Sounder
    ) -> None:
        self._rng = generator(seed, Stream.CIR, vehicle_id, beacon_key)
        self._frequency_hz = float(frequency_hz)
        self._sounder = sounder
        self._channel: ClusterChannel | None = None
        self._at: Enu = (0.0, 0.0, 0.0)
        self._flown_m = 0.0
        self._captures = 0

    def capture(
        self,
        vehicle_enu_m: Enu,
        toward_enu: Enu,
        reception: Reception,
        *,
        report_offset_db: float,
        encoding: CirEncoding,
        window: tuple[int, int] | None,
        tunnel: bool,
    ) -> list[SarCirFields]:
        """The fragments of one capture.

        ``window`` is (first tap, tap count) in the full response, None for the 64 taps round
        the first path; ``toward_enu`` points from the vehicle to the beacon.
        """
        channel = self._evolve(vehicle_enu_m, toward_enu, reception.obstruction.line_of_sight)
        sounder = self._sounder
        first_path = sounder.first_path_tap + FIRST_PATH_JITTER_TAPS * float(self._rng.uniform(-1.0, 1.0))
        if window is None:
            first, count = window_round_first_path(sounder.taps, first_path)
        else:
            first = min(window[0], sounder.taps - 1)
            count = min(window[1], sounder.taps - first)
        noise = THERMAL_NOISE_DBM_HZ + 10 * math.log10(sounder.bandwidth_hz) + 6.0
        snr = reception.rss_dbm - report_offset_db - noise + ACCUMULATION_GAIN_DB
        response = channel.impulse_response(
            taps=count,
            tap_spacing_ns=sounder.tap_spacing_ns,
            bandwidth_hz=sounder.bandwidth_hz,
            first_path_tap=first_path - first,
            snr_db=min(snr, SNR_MAX_DB),
            rng=self._rng,
        )
        self._captures += 1
        index = first_path - first + INDEX_NOISE_TAPS * float(self._rng.standard_normal())
        return encode_capture(
            response,
            encoding=encoding,
            tap_spacing_ns=sounder.tap_spacing_ns,
            capture_id=self._captures,
            first_tap=first,
            first_path_index=index,
            max_data_bytes=TUNNEL_DATA_BYTES if tunnel else MAX_DATA_BYTES,
        )

    def _evolve(self, vehicle_enu_m: Enu, toward_enu: Enu, line_of_sight: bool) -> ClusterChannel:
        displacement = np.subtract(vehicle_enu_m, self._at)
        self._flown_m += float(np.linalg.norm(displacement))
        channel = self._channel
        if channel is None or channel.line_of_sight != line_of_sight or self._flown_m > REDRAW_DISTANCE_M:
            channel = draw_channel(
                self._rng,
                line_of_sight=line_of_sight,
                frequency_hz=self._frequency_hz,
                first_path_direction_enu=np.array(toward_enu) if line_of_sight else None,
            )
            self._flown_m = 0.0
        else:
            channel = channel.moved(self._rng, displacement)
        self._channel, self._at = channel, vehicle_enu_m
        return channel
