"""Numbers and rows as the channel studies write them."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from io import StringIO


def csv_text(columns: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """CSV with a header, lines ended by a line feed on every machine."""
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    return text.getvalue()


def number(value: float) -> str:
    """Six significant digits; empty where there is none."""
    return "" if math.isnan(value) else f"{value:.6g}"
