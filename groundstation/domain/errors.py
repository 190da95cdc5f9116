"""One root for every error that a user may see.

Four kinds, because four different people act on them: the caller corrects an input, the
field engineer looks at a peer, the administrator frees a resource, we mend an internal
fault. A message states what was seen and what is needed, in one line.
"""

from __future__ import annotations

from typing import ClassVar


class GroundstationError(Exception):
    """Root of the project's errors. ``exit_code`` is what the command line ends with."""

    exit_code: ClassVar[int] = 1


class InputError(GroundstationError):
    """What the caller gave cannot be used (a URL, a file, a setting, a set of links)."""


class UsageError(InputError):
    """The command line itself is wrong: an unknown option, a value out of range."""

    exit_code: ClassVar[int] = 2


class PeerError(GroundstationError):
    """A vehicle, sensor or other station sent something that cannot be used, or nothing."""


class ResourceError(GroundstationError):
    """The machine refuses: a port in use, a missing device, a full disk."""


class InternalError(GroundstationError):
    """A fault of ours. The message says where to report it."""
