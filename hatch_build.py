"""Build hook: what must exist before the package can be installed or shipped.

Every build generates the MAVLink dialect; a wheel also carries the built page. An installed
station neither generates nor builds anything: it may lie on a read-only disk without internet.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PAGE_SOURCE = "web/dist"
PAGE_TARGET = "groundstation/server/page"


class CustomBuildHook(BuildHookInterface):  # type: ignore[type-arg]
    """Generates the dialect; puts the page into wheels and fails where it has not been built."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Called by hatchling before files are collected; ``version`` is ``standard`` or ``editable``."""
        root = Path(self.root)
        if self.target_name != "wheel":
            return
        self._generate_dialect(root)
        if version == "editable":
            return
        page = root / PAGE_SOURCE
        if not (page / "index.html").is_file():
            raise SystemExit(
                f"error: the page is not built: no {PAGE_SOURCE}/index.html;"
                " run: npm --prefix web ci && npm --prefix web run build"
            )
        build_data["force_include"][str(page)] = PAGE_TARGET

    @staticmethod
    def _generate_dialect(root: Path) -> None:
        sys.path.insert(0, str(root))
        try:
            from groundstation.domain.errors import GroundstationError
            from groundstation.mavlink.generate import generate
        finally:
            sys.path.remove(str(root))
        try:
            generate(root / "groundstation" / "mavlink" / "generated")
        except GroundstationError as error:
            raise SystemExit(f"error: {error}") from error
