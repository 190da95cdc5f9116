"""``sim-sitl study tracking``: the tracker beside the exact Bayes filter and its peers."""

from sim_sitl.studies.tracking.study import run

__all__ = ["run"]
