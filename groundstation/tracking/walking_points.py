"""Places with all that belongs to them: the particles of a walker, and samples of the still belief.

Exists so that standing still and walking are foretold by the same code: both are points, and only
one kind moves. Rule: the last axis of every array counts the points.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from groundstation.localization.likelihood import DB_OF_LOG, logs_of_squares
from groundstation.localization.problem import FloatArray, SignalModel
from groundstation.tracking.belief import Belief


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """N points; V vehicles."""

    position_enu_m: FloatArray
    """(3, N) metres."""
    velocity_mps: FloatArray
    """(2, N) east, north."""
    orders: FloatArray
    """(3, N) β_LOS, β_NLOS and the order of the antennas' null."""
    nuisance: FloatArray
    """(1 + V, N) mean of power and offsets, in prior standard deviations."""
    past_db: FloatArray
    """(2, V, N) path loss and null loss of the newest window of each vehicle, then."""
    share_log: FloatArray
    """(S, N) log mass of the nodes of π, the share of links in line of sight."""
    bias_rad: FloatArray
    """(2, V, N) mean of each vehicle's constant error of azimuth and elevation."""
    bias_rad2: FloatArray
    """(2, V, N) its variance."""

    @property
    def count(self) -> int:
        """N."""
        return int(self.position_enu_m.shape[1])

    def take(self, chosen: Any) -> Points:
        """The points that ``chosen`` selects, by number."""
        return Points(*(getattr(self, entry.name).take(chosen, axis=-1) for entry in fields(self)))

    def part(self, which: slice) -> Points:
        """Some that stand side by side; their arrays are these ones' still."""
        return Points(*(getattr(self, entry.name)[..., which] for entry in fields(self)))

    def settled(self) -> Points:
        """Laid out in memory as ``restore`` lays it, so that sums go on bit for bit after a restart."""
        return Points(*(np.ascontiguousarray(getattr(self, entry.name)) for entry in fields(self)))

    @staticmethod
    def joined(one: Points, other: Points) -> Points:
        """Both, one after the other."""
        pairs = ((getattr(one, entry.name), getattr(other, entry.name)) for entry in fields(Points))
        return Points(*(np.concatenate(pair, axis=-1) for pair in pairs))

    @staticmethod
    def none(links: int, model: SignalModel) -> Points:
        """No point."""
        shapes = (3,), (2,), (3,), (1 + links,), (2, links), (len(model.los_shares),), (2, links), (2, links)
        return Points(*(np.zeros((*shape, 0)) for shape in shapes))

    def grown(self, links: int, model: SignalModel) -> Points:
        """With room for vehicles not heard before; their losses count only once they are heard."""
        more = links - self.past_db.shape[1]
        if more <= 0:
            return self

        def padded(values: FloatArray, fill: float = 0.0) -> FloatArray:
            width = [(0, 0)] * values.ndim
            width[-2] = (0, more)
            return np.pad(values, width, constant_values=fill)

        return Points(
            self.position_enu_m, self.velocity_mps, self.orders, padded(self.nuisance),
            padded(self.past_db), self.share_log, padded(self.bias_rad),
            padded(self.bias_rad2, model.angle_bias_std_rad**2),
        )  # fmt: skip

    def state(self) -> dict[str, Any]:
        """As arrays."""
        return {entry.name: getattr(self, entry.name).copy() for entry in fields(self)}

    @classmethod
    def restore(cls, tree: dict[str, Any]) -> Points:
        """The reverse."""
        parts = {entry.name: np.array(tree[entry.name], dtype=np.float64, order="C") for entry in fields(cls)}
        for name in ("past_db", "bias_rad", "bias_rad2"):
            if parts[name].ndim == 2:
                # Of nobody, heard by nobody: as lists such arrays forget how deep they were.
                parts[name] = np.zeros((2, 0, 0))
        return cls(**parts)


def losses_db(offset_m: FloatArray, null: bool) -> FloatArray:
    """(2, …) path loss and, with ``null``, loss in an antenna's null of order 1, over ``offset_m`` (3, …)."""
    east, north, up = offset_m
    flat = east * east
    flat += north * north
    path, deep = logs_of_squares(up * up + flat, flat, null)
    result = np.zeros((2, *path.shape))
    np.multiply(path, DB_OF_LOG, out=result[0])
    if null:
        np.multiply(deep, DB_OF_LOG, out=result[1])
    return result


def grown_covariance(covariance: FloatArray, links: int) -> FloatArray:
    """(1 + V, 1 + V) with the prior of vehicles not heard before."""
    size = covariance.shape[0]
    if size >= 1 + links:
        return covariance
    wider = np.eye(1 + links)
    wider[:size, :size] = covariance
    return wider


def drawn(
    belief: Belief,
    model: SignalModel,
    links: list[int],
    past_enu_m: FloatArray,
    count: int,
    rng: np.random.Generator,
) -> tuple[Points, FloatArray]:
    """``count`` points of a still belief, and the covariance of their nuisances, in ``model``'s units.

    Places by systematic sampling of the boxes, evenly inside each; exponents and shares given the
    place; power and offsets' mean given both. ``past_enu_m`` (V, 3): where the newest window of each of
    ``links`` was heard.
    """
    mesh, evidence = belief.mesh, belief.evidence
    cell = systematic(belief.mass, count, rng)
    spread = mesh.half_m[cell][:, [0, 0, 1]]
    place = (mesh.center_enu_m[cell] + spread * rng.uniform(-1.0, 1.0, (count, 3))).T
    # A box at the edge lies partly outside.
    place = belief.area.clip(place.T).T
    orders = evidence.orders_drawn(cell, belief.exponents, rng.random((2, count)))
    right = evidence.level_loading[:, None] + np.einsum(
        "on,ovn->vn", orders, evidence.loading_path[:, :, cell]
    )
    mean, covariance = (
        np.linalg.solve(evidence.loading_loading, right),
        np.linalg.inv(evidence.loading_loading),
    )
    if model.transmit_power_std_db > 0.0:
        # A belief that was begun anew starts from a power that is known better.
        own = belief.model
        factor = own.transmit_power_std_db / model.transmit_power_std_db
        shift = (own.transmit_power_mean_dbm - model.transmit_power_mean_dbm) / model.transmit_power_std_db
        mean[0] = shift + factor * mean[0]
        covariance[0] *= factor
        covariance[:, 0] *= factor
    # The belief may know fewer vehicles, in another order.
    known = belief.vehicles
    mine = np.array([number for number, link in enumerate(links) if link in known], dtype=np.int64)
    its = np.array([known.index(link) for link in links if link in known], dtype=np.int64)
    points = Points(
        place, np.zeros((2, count)), orders, np.zeros((1, count)), np.zeros((2, 0, count)),
        evidence.angle_log[:, cell] - evidence.angle_log[:, cell].max(axis=0),
        np.zeros((2, 0, count)), np.zeros((2, 0, count)),
    ).grown(len(links), model)  # fmt: skip
    to, of = np.concatenate([[0], 1 + mine]), np.concatenate([[0], 1 + its])
    points.nuisance[to] = mean[of]
    wider = np.eye(1 + len(links))
    wider[np.ix_(to, to)] = covariance[np.ix_(of, of)]
    points.past_db[:] = losses_db(place[:, None] - past_enu_m.T[:, :, None], model.has_antenna_null)
    points.bias_rad[:, mine] = belief.bearings.mean[:, its][:, :, cell]
    points.bias_rad2[:, mine] = belief.bearings.variance[:, its][:, :, cell]
    return points, wider


def systematic(mass: FloatArray, count: int, rng: np.random.Generator) -> Any:
    """(count,) indices, each as often as its share of the mass says, to within one."""
    reached = np.cumsum(mass)
    marks = (np.arange(count) + rng.random()) * (reached[-1] / count)
    return np.minimum(np.searchsorted(reached, marks), mass.size - 1)
