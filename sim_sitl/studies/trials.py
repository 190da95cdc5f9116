"""N trials of one case: what solvers are given, and beside it the truth they are scored by.

Exists so that every method, and the limit, work on the very same draws. Rule: all trials of
a case share one search area and one frame (ENU, metres, centred on that area), and what a
solver may see (``links``, ``area``, ``model``, ``bias_max_db``) is apart from the truth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from groundstation.localization import Links, SearchArea, SignalModel
from groundstation.localization.problem import BoolArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Trials:
    """N trials of one case with K links each."""

    links: Links
    """(N, K): what solvers are given; ``los_probability`` holds true labels or the classifier's answer."""
    truth_enu_m: FloatArray
    """(N, 3) where the target is, metres."""
    area: SearchArea
    """Where it may be, as solvers are told."""
    model: SignalModel
    """What solvers are told of the radio."""
    transmit_power_dbm: FloatArray
    """(N,) true transmit power."""
    bias_max_db: FloatArray
    """(N,) b_max that the robust solvers assume (the paper draws it for each trial)."""
    line_of_sight: BoolArray
    """(N, K) which links truly are line of sight."""

    @property
    def count(self) -> int:
        """N."""
        return int(self.truth_enu_m.shape[0])

    def rows(self, chosen: Any) -> Trials:
        """The trials that ``chosen`` (mask, slice or indices) selects."""
        return replace(
            self,
            links=self.links.subset(chosen),
            truth_enu_m=self.truth_enu_m[chosen],
            transmit_power_dbm=self.transmit_power_dbm[chosen],
            bias_max_db=self.bias_max_db[chosen],
            line_of_sight=self.line_of_sight[chosen],
        )
