"""Help on records: docstrings of their fields, without internals of pydantic."""

import ast
import inspect
import sys
from itertools import pairwise
from typing import get_type_hints


class Record(type):
    """Metaclass of dataclasses with slots. `dir` and `help` leave out special attributes, such as those of pydantic."""

    def __dir__(cls) -> list[str]:
        return [name for name in super().__dir__() if not name.startswith("__")]


def document_fields(module: str) -> None:
    """Let `help` show the docstrings below the fields of a module's records, and types without limits.

    Call it at the end of the module. Python's help reads docstrings of slots from the values of `__slots__`.
    """
    for node in ast.parse(inspect.getsource(sys.modules[module])).body:
        if not isinstance(node, ast.ClassDef) or not isinstance(kind := vars(sys.modules[module])[node.name], Record):
            continue
        texts = {}
        for field, below in pairwise(node.body):
            if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr):
                texts[ast.unparse(field.target)] = inspect.cleandoc(ast.literal_eval(below.value))
        hints, signature = get_type_hints(kind), inspect.signature(kind)
        plain = [one.replace(annotation=hints[one.name]) for one in signature.parameters.values()]
        setattr(kind, "__slots__", texts)  # noqa: B010  (mypy takes assignments for declarations)
        setattr(kind, "__signature__", signature.replace(parameters=plain))  # noqa: B010
