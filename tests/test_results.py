"""Every verb writes the record of its name, and nothing beside it."""

import ast
import inspect
import textwrap
import typing

from excitant import results
from excitant.cli import app
from excitant.results import Record, Result

KINDS = [kind for kind in vars(results).values() if isinstance(kind, type)]
RECORDS = [kind for kind in KINDS if issubclass(kind, Record)]


def test_every_command_has_a_record() -> None:
    commands = {name for name in app if not name.startswith("-")}
    verbs = {kind.__struct_config__.tag for kind in typing.get_args(Result)}
    without = {"show", "completion", "report"}  # a page, a script, and the run that it renders
    assert commands - without <= verbs
    assert verbs - commands == {"compare"}


def test_every_field_is_documented() -> None:
    """The reference of result.json is made of the strings below the fields."""
    for kind in RECORDS:
        [body] = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
        assert isinstance(body, ast.ClassDef)
        fields = [k for k, node in enumerate(body.body) if isinstance(node, ast.AnnAssign)]
        for k in fields:
            text = body.body[k + 1 : k + 2]
            assert text, ast.unparse(body.body[k])
            assert isinstance(text[0], ast.Expr), ast.unparse(body.body[k])
            assert isinstance(text[0].value, ast.Constant)
