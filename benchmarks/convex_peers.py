"""The five convex programs in CVXPY, solved by Clarabel: what ``bench_convex`` measures us against.

Each is written once and serves as both forms that people use: with the constants of one problem, built
anew for each solve, and parametrised by the rules of DPP, built once.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from convex_problems import AREA, LINKS, Numbers

from groundstation.localization.region import Region

TOLERANCE = {"tol_gap_abs": 1e-9, "tol_gap_rel": 1e-9, "tol_feas": 1e-9}


class Peer:
    """A program in CVXPY whose data are filled in by ``fill``: parameters, or constants of one problem."""

    def __init__(self, cp: Any, name: str, region: Region, one: Numbers | None) -> None:
        self.cp = cp
        self.data: dict[str, tuple[Any, Callable[[Numbers], Any]]] = {}
        self.extra: list[Any] = []
        self.one, self.region = one, region
        self.x, objective, constraints = getattr(self, name)()
        self.problem = cp.Problem(cp.Minimize(objective), constraints)

    def value(self, name: str, compute: Callable[[Numbers], Any], shape: Any, nonneg: bool = False) -> Any:
        """A constant in the program written for one problem, a parameter in the parametrised one."""
        if self.one is not None:
            return compute(self.one)
        parameter = self.cp.Parameter(shape, nonneg=nonneg)
        self.data[name] = (parameter, compute)
        return parameter

    def solve(self, one: Numbers) -> Any:
        """The place (3,), scaled."""
        for parameter, compute in self.data.values():
            parameter.value = compute(one)
        self.problem.solve(solver=self.cp.CLARABEL, **TOLERANCE)
        return self.x.value

    def inside(self, x: Any) -> list[Any]:
        """Heights and disc."""
        return [self.cp.norm(x[:2]) <= 1.0, x[2] <= self.region.half_height, x[2] >= -self.region.half_height]

    def lsre_socp(self) -> Any:
        """(64) as printed, ζ = 1/m_t."""
        cp, ends = self.cp, 2 * LINKS
        x, s, y, tau1, tau2 = cp.Variable(3), *(cp.Variable(ends) for _ in range(4))
        m = self.value("m", lambda one: np.concatenate([one.gain * one.low, one.gain / one.low]), ends, True)
        place = self.value("place", lambda one: np.tile(one.place, (2, 1)), (ends, 3))
        relative = cp.multiply(m, s)

        def rotated(a: Any, b: Any, c: Any) -> Any:
            return cp.SOC(a + b, cp.vstack([a - b, math.sqrt(2.0) * c]), axis=0)

        one, half = np.ones(ends), np.full(ends, 0.5)
        constraints = [
            rotated(tau1, y, math.sqrt(2.0) * one),
            rotated(y, half, relative),
            rotated(tau2, half, relative),
            cp.norm(place - cp.vstack([x] * ends), axis=1) <= s,
        ]
        return x, cp.sum(tau1 + tau2), constraints + self.inside(x)

    def lsre_ccp(self) -> Any:
        """The convex program of one convex–concave step."""
        cp = self.cp
        x, t, far = cp.Variable(3), cp.Variable(LINKS), cp.Variable(LINKS)
        slope = self.value("slope", lambda one: one.gain[:, None] * one.tangent, (LINKS, 3))
        shift = self.value("shift", lambda one: one.gain * (one.tangent * one.place).sum(axis=1), LINKS)
        gain = self.value("gain", lambda one: one.gain, LINKS, True)
        away = self.value("away", lambda one: one.gain[:, None] * one.place, (LINKS, 3))
        weight = self.value("weight", lambda one: one.weight, LINKS, True)
        columns = cp.vstack([gain * x[axis] for axis in range(3)]).T
        constraints = [t >= cp.inv_pos(slope @ x - shift), cp.norm(columns - away, axis=1) <= far]
        return x, weight @ cp.square(t) + weight @ cp.square(far), constraints + self.inside(x)

    def _lifted(self) -> tuple[Any, Any]:
        cp = self.cp
        z = cp.Variable((4, 4), PSD=True)
        square = self.value("square", lambda one: one.gain**2, LINKS, True)
        cross = self.value("cross", lambda one: 2.0 * one.gain[:, None] ** 2 * one.place, (LINKS, 3))
        rest = self.value("rest", lambda one: one.gain**2 * np.square(one.place).sum(axis=1), LINKS, True)
        return z, square * (z[0, 0] + z[1, 1] + z[2, 2]) - cross @ z[:3, 3] + rest

    def lsre_sdp(self) -> Any:
        """(62) with Z₄₄ = 1/m_t²; the two ends of a link taken together, as we do."""
        cp = self.cp
        z, q = self._lifted()
        weight = self.value("weight", lambda one: one.weight, LINKS, True)
        return z[:3, 3], weight @ cp.inv_pos(q) + weight @ q if self.one is not None else self._split(z, q), [
            z[3, 3] == 1.0, *self.inside(z[:3, 3]), *self.extra
        ]  # fmt: skip

    def _split(self, z: Any, q: Any) -> Any:
        # A parameter times a parameter is not DPP: the relative square gets a variable of its own.
        cp = self.cp
        relative = cp.Variable(LINKS)
        self.extra = [relative == q]
        weight = self.data["weight"][0]
        return weight @ cp.inv_pos(relative) + weight @ relative

    def rwls_sdp(self) -> Any:
        """min Σ w_k τ_k, (e² q_k − 1)² ≤ τ_k at both ends."""
        cp = self.cp
        z, q = self._lifted()
        relative, tau = cp.Variable(LINKS), cp.Variable(LINKS)
        weight = self.value("weight", lambda one: one.distance_weight, LINKS, True)
        small = self.value("small", lambda one: one.low**2, LINKS, True)
        large = self.value("large", lambda one: one.low**-2, LINKS, True)
        constraints = [z[3, 3] == 1.0, relative == q, *self.inside(z[:3, 3])]
        constraints += [cp.square(cp.multiply(e, relative) - 1.0) <= tau for e in (small, large)]
        return z[:3, 3], weight @ tau, constraints


class RangePeer:
    """The SDP/SOCP hybrid in CVXPY: with the constants of one problem, or parametrised."""

    def __init__(self, cp: Any, constants: dict[str, Any] | None) -> None:
        self.cp = cp
        shapes = {"root": LINKS, "inverse": LINKS, "rows": (2 * LINKS, 3), "right": 2 * LINKS}
        shapes |= {"place": (LINKS, 3), "square": LINKS}
        signed = {"rows", "right", "place"}
        self.data = {name: cp.Parameter(shape, nonneg=name not in signed) for name, shape in shapes.items()}
        data = self.data if constants is None else constants
        z, reach = cp.Variable((4, 4), PSD=True), cp.Variable(LINKS)
        self.x = x = z[:3, 3]
        lifted = z[0, 0] + z[1, 1] + z[2, 2] - 2.0 * data["place"] @ x + data["square"]
        rules = [z[3, 3] == 1.0, cp.square(reach) <= lifted]
        rules += [cp.norm(x - data["place"][k]) <= reach[k] for k in range(LINKS)]
        fit = cp.multiply(data["inverse"], reach) - data["root"]
        cost = cp.sum_squares(fit) + cp.sum_squares(data["rows"] @ x - data["right"])
        self.problem = cp.Problem(cp.Minimize(cost), rules)

    def solve(self, data: dict[str, Any]) -> tuple[float, Any]:
        """Optimum and place (3,), metres."""
        for name, parameter in self.data.items():
            parameter.value = data[name]
        self.problem.solve(solver=self.cp.CLARABEL, **TOLERANCE)
        return float(self.problem.value), AREA.radius_m * np.asarray(self.x.value)
