"""``settings.toml`` of a session: what its engines were run with, in the form of a settings file.

A replay reads it, a restart goes on with it, and a person can use it for the next mission
(``--config``).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from groundstation.config import Config, LoadedConfig, load_config
from groundstation.domain.errors import InputError, ResourceError

NAME = "settings.toml"


def write_settings(directory: Path, loaded: LoadedConfig) -> None:
    """Beside the journal. Raises ResourceError."""
    try:
        (directory / NAME).write_text(loaded.text(), encoding="utf-8")
    except OSError as error:
        raise ResourceError(f"cannot write {directory / NAME}: {error.strerror}") from error


def read_settings(directory: Path) -> Config:
    """The settings of the session in ``directory``. Raises InputError."""
    if not (directory / NAME).is_file():
        raise InputError(f"{directory}: not a session's directory (it has no {NAME})")
    return load_config(file=directory / NAME).config


def with_engines_of(config: Config, directory: Path) -> Config:
    """``config``, but what the engines are run with as the session in ``directory`` began: or its
    replay would differ. Raises InputError.
    """
    kept = read_settings(directory)
    return replace(
        config,
        measurement=kept.measurement,
        channel=kept.channel,
        estimator=kept.estimator,
        safety=kept.safety,
        command=kept.command,
    )
