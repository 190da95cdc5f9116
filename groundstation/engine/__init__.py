"""The two engines: ingest (frames to windows) and estimator (windows to targets).

Rule: both are state machines over journalled inputs. They read no clock, no environment and no
global random state, so that a replay gives what the live run gave.
"""
