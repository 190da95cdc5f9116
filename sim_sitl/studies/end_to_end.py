"""Links of the end-to-end study (V-D): rows of the data set, labelled by the shipped classifier.

Exists so that what a solver gets here went through what the service runs: responses from the
data set's generator (plain kind), P(line of sight) from the classifier over a link's packets.
Rules: all randomness is the caller's generator; rows are drawn afresh and never come from a seed
that a data set is made with (a data set's streams are keyed by seed and row, these by 64
random bits); the label given is the classifier's, and the true state only scores.

Received power is the signal's: what the row says of its signal-to-noise ratio over the
sounder's noise floor. The row's own total also holds the noise of 1,016 taps of 500 MHz, which no
receiver that finds a response would count.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.optimize import isotonic_regression

from groundstation.channel import ChannelCapture, load_classifier
from groundstation.channel.classifier import Classifier
from groundstation.localization import SignalModel
from groundstation.localization.problem import BoolArray, FloatArray
from sim_sitl.dataset.geometry import FREQUENCY_HZ, PATH_LOSS
from sim_sitl.dataset.options import DatasetOptions, dataset_sounder
from sim_sitl.dataset.rows import NOISE_DENSITY_DBM_HZ, PROCESSING_GAIN_DB, LinkRows, link_rows

PACKETS = 4
"""Consecutive captures of a link, as the data set has them; the classifier takes them together."""
CLOSE_IN_1M_DB = 20.0 * math.log10(4.0 * math.pi * FREQUENCY_HZ / 299_792_458.0)
"""Free space over the first metre."""
CALIBRATION_LINKS = 1000
"""Links of each state that the channel's constants are measured on, apart from every trial."""
LABEL_LINKS = 500
"""Links of each state that the worth of the classifier's labels is measured on."""
_CALIBRATION_SEED = 867_500
_BLOCK = 512


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """(N, K) links as the data set and the classifier give them."""

    offset_m: FloatArray
    """(N, K, 3) from target to vehicle, at the newest packet."""
    excess_db: FloatArray
    """(N, K) received power over close-in path loss: P_r − P_t + L(1 m) + 10 β log₁₀ d, packets averaged."""
    los_probability: FloatArray
    """(N, K) the classifier's; NaN where it was not asked."""


def draw_rows(line_of_sight: BoolArray, rng: np.random.Generator, packets: int = PACKETS) -> Rows:
    """A row of the data set for each link (N, K), classified from ``packets`` captures."""
    return _draw(line_of_sight, rng, DatasetOptions(packets_per_link=packets), shipped_classifier())


@cache
def shipped_classifier() -> Classifier:
    """The service's classifier, loaded once a process."""
    return load_classifier()


def _draw(
    line_of_sight: BoolArray, rng: np.random.Generator, options: DatasetOptions, classifier: Classifier | None
) -> Rows:
    states = line_of_sight.ravel()
    seeds = rng.integers(2**63, size=states.size)
    offset, excess = np.empty((states.size, 3)), np.empty(states.size)
    probability = np.full(states.size, np.nan)
    for start in range(0, states.size, _BLOCK):
        block = range(start, min(start + _BLOCK, states.size))
        # The generator alternates labels: even numbers are line of sight.
        drawn = [
            link_rows(np.random.default_rng(seeds[link]), int(not states[link]), options) for link in block
        ]
        for link, rows in zip(block, drawn, strict=True):
            offset[link] = [rows.columns[name][-1] for name in ("x_m", "y_m", "z_m")]
            excess[link] = _excess_db(rows, bool(states[link]))
        if classifier is not None:
            verdicts = classifier.classify([_captures(rows) for rows in drawn])
            probability[block.start : block.stop] = [verdict.los_probability for verdict in verdicts]
    shape = line_of_sight.shape
    return Rows(offset.reshape(*shape, 3), excess.reshape(shape), probability.reshape(shape))


def _captures(rows: LinkRows) -> list[ChannelCapture]:
    spacing, told = rows.columns["tap_spacing_ns"], rows.columns["first_path_index"]
    return [
        ChannelCapture(magnitude, float(spacing[packet]), float(told[packet]))
        for packet, magnitude in enumerate(rows.cir_magnitude)
    ]


def _excess_db(rows: LinkRows, line_of_sight: bool) -> float:
    columns = rows.columns
    floor = NOISE_DENSITY_DBM_HZ + 10.0 * np.log10(columns["bandwidth_hz"]) - PROCESSING_GAIN_DB
    path = CLOSE_IN_1M_DB + 10.0 * PATH_LOSS[line_of_sight][0] * np.log10(columns["range_m"])
    return float(np.mean(columns["snr_db"] + floor - columns["transmit_power_dbm"] + path))


@cache
def calibration_rows(links: int = CALIBRATION_LINKS) -> dict[bool, Rows]:
    """By line of sight: (1, links) rows of a seed of their own, unclassified."""
    options = DatasetOptions(sounder=dataset_sounder(taps=16), packets_per_link=1)
    rng = np.random.default_rng(_CALIBRATION_SEED)
    return {state: _draw(np.full((1, links), state), rng, options, None) for state in (True, False)}


@cache
def _label_calibration(links: int) -> tuple[FloatArray, FloatArray]:
    """(logit of P(line of sight), log likelihood ratio LOS : NLOS): a rising broken line.

    Isotonic regression (pool adjacent violators) over ``links`` of each state, half a link
    of the other state added to every pool.
    """
    rng = np.random.default_rng(_CALIBRATION_SEED + 1)
    states = np.repeat([True, False], links)
    logit = _logit(draw_rows(states[None, :], rng).los_probability[0])
    order = np.argsort(logit, kind="stable")
    pools = isotonic_regression(states[order].astype(np.float64)).blocks
    clear = np.add.reduceat(states[order].astype(np.float64), pools[:-1])
    size = np.diff(pools)
    centre = np.add.reduceat(logit[order], pools[:-1]) / size
    # The halves weigh more in small pools: keep it rising.
    return centre, np.maximum.accumulate(np.log((clear + 0.5) / (size - clear + 0.5)))


def label_odds(probability: FloatArray, links: int = LABEL_LINKS) -> FloatArray:
    """(…) how much likelier the classifier's answers (…) are with a line of sight than without.

    Measured on ``links`` of each state that no trial holds, and so right where the classifier's
    own probabilities are not.
    """
    return np.asarray(np.exp(np.interp(_logit(probability), *_label_calibration(links))))


def _logit(probability: FloatArray) -> FloatArray:
    # The classifier rounds to six decimals: 0 and 1 stand for half a step inside.
    inside = np.clip(probability, 2.5e-7, 1.0 - 2.5e-7)
    return np.asarray(np.log(inside / (1.0 - inside)))


@dataclass(frozen=True, slots=True)
class DatasetChannel:
    """The cluster model's received power, on the scale of eq. (7).

    Close-in path loss, shadow fading, foliage and penetration, antenna, polarisation,
    blockage and small-scale fading as the data set's rows have them. Reported with the first
    metre's free-space loss and the mean of what LOS links lose beyond it added back: what
    flying over a beacon in plain sight tells any station.
    """

    calibration_links: int = CALIBRATION_LINKS
    """Links of each state that the constants told are measured on."""

    @property
    def reported_db(self) -> float:
        """What is added back beside the first metre's loss, dB."""
        return -float(calibration_rows(self.calibration_links)[True].excess_db.mean())

    @property
    def told(self) -> SignalModel:
        """Eqs. (7), (8) with the means and variances of the calibration's links.

        What NLOS links lose beyond their exponent is b ~ U(0, b_max) of the same mean; what
        spread that leaves is σ_s.
        """
        rows = calibration_rows(self.calibration_links)
        clear, obstructed = rows[True].excess_db, rows[False].excess_db + self.reported_db
        bias_max = max(-2.0 * float(obstructed.mean()), 1.0)
        variance = max(float(obstructed.var()) - bias_max**2 / 12.0, 1.0)
        exponent = PATH_LOSS[False][0]
        return SignalModel(
            rss_std_db=float(clear.std()), los_exponent=PATH_LOSS[True][0],
            nlos_exponent_min=exponent - 0.1, nlos_exponent_max=exponent + 0.1, first_exponent=exponent,
            nlos_bias_max_db=bias_max, nlos_rss_std_db=math.sqrt(variance),
        )  # fmt: skip

    @property
    def bias_max_db(self) -> tuple[float, float]:
        """About the bound told, as wide as the paper's range."""
        bound = self.told.nlos_bias_max_db
        return bound - 1.0, bound + 1.0

    def loss_db(self, offset_m: FloatArray, line_of_sight: BoolArray, rng: np.random.Generator) -> FloatArray:
        """(N, K) loss of rows drawn for it; where rows are at hand already, see ``loss_of``."""
        options = DatasetOptions(sounder=dataset_sounder(taps=16), packets_per_link=1)
        return self.loss_of(_draw(line_of_sight, rng, options, None), offset_m, line_of_sight)

    def loss_of(self, rows: Rows, offset_m: FloatArray, line_of_sight: BoolArray) -> FloatArray:
        """(N, K) loss at ``offset_m`` (N, K, 3) of links that lose what ``rows`` do beyond distance."""
        exponent = np.where(line_of_sight, PATH_LOSS[True][0], PATH_LOSS[False][0])
        path: FloatArray = 10.0 * exponent * np.log10(np.linalg.norm(offset_m, axis=-1))
        return path - rows.excess_db - self.reported_db
