"""Ground station that finds buried or lost people by the faint radio of their phones."""

__version__ = "0.1.0"
