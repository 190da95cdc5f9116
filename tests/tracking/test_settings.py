from __future__ import annotations

import ast
import itertools
from dataclasses import fields
from pathlib import Path

import pytest

import groundstation.localization.settings as localization_settings
import groundstation.tracking.settings as tracking_settings
from groundstation.engine import estimator_settings


@pytest.mark.parametrize(
    ("module", "name"),
    [
        (tracking_settings, "TrackingSettings"),
        (localization_settings, "LocalizationSettings"),
        (estimator_settings, "EstimatorSettings"),
    ],
)
def test_every_setting_is_documented(module: object, name: str) -> None:
    tree = ast.parse(Path(module.__file__).read_text(encoding="utf-8"))  # type: ignore[attr-defined]
    body = next(node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == name).body
    documented = {
        before.target.id  # type: ignore[union-attr]
        for before, after in itertools.pairwise(body)
        if isinstance(before, ast.AnnAssign)
        and isinstance(after, ast.Expr)
        and isinstance(after.value, ast.Constant)
    }
    assert documented == {field.name for field in fields(getattr(module, name))}
