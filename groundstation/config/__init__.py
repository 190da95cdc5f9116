"""The station's settings: command line > environment > file > default, each with its origin.

Rule: a name that no setting has, or a value of the wrong kind, is an error that says where
it stands, what was seen and what is needed; nothing is silently ignored.
"""

from groundstation.config.load import LoadedConfig, load_config, parse_assignments
from groundstation.config.schema import Config, TargetSettings
from groundstation.config.settings_tree import SettingValue

__all__ = ["Config", "LoadedConfig", "SettingValue", "TargetSettings", "load_config", "parse_assignments"]
