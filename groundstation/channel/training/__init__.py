"""Training of the channel classifier (the ``train`` extra: torch, onnx, onnxscript).

Why: a user with measured responses trains, calibrates and exports a classifier with one
command. Rule kept here: torch is imported inside functions of this package only, so that
the service never loads it, and only after the data were found sound.
"""

from groundstation.channel.training.run import TrainingOptions, TrainingProgress, TrainingReport, train

__all__ = ["TrainingOptions", "TrainingProgress", "TrainingReport", "train"]
