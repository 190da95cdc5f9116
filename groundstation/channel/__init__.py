"""Channel identification: P(line of sight) per radio link from channel impulse responses.

Why: angles and powers of an obstructed link mislead; localisation needs to know which links
to trust. ``training/`` (the ``train`` extra) is imported by nothing here.
"""

from groundstation.channel.capture import ChannelCapture, Verdict, VerdictStatus
from groundstation.channel.classifier import Classifier, load_classifier
from groundstation.channel.settings import ChannelSettings

__all__ = ["ChannelCapture", "ChannelSettings", "Classifier", "Verdict", "VerdictStatus", "load_classifier"]
