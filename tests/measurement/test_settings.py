"""Each setting is documented where it is declared, with its unit in its name or line."""

import ast
import dataclasses
import inspect

from groundstation.measurement import settings as module


def test_every_setting_has_a_line_that_explains_it():
    (declared,) = [n for n in ast.parse(inspect.getsource(module)).body if isinstance(n, ast.ClassDef)]
    body = declared.body[1:]
    names = [node.target.id for node in body if isinstance(node, ast.AnnAssign)]
    for field, text in zip(body[::2], body[1::2], strict=True):
        assert isinstance(field, ast.AnnAssign)
        assert isinstance(text, ast.Expr)
        assert isinstance(text.value, ast.Constant)
        if field.target.id.endswith("_s"):
            assert "second" in text.value.value, field.target.id
    assert names == [field.name for field in dataclasses.fields(module.MeasurementSettings)]
