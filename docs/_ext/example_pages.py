"""The examples, each with its first lines and its source."""

import ast
from pathlib import Path

INTRO = """\
# Examples

Each is a file in `examples/` that runs by itself, `.venv/bin/python examples/NAME.py`, and in a test on a small budget.
`--help` tells its arguments.
"""
ENTRY = """
## `{name}`

{text}

:::{{dropdown}} Source
```{{literalinclude}} ../../examples/{name}
:language: python
```
:::
"""
ORDER = ("quick_start", "sb3_ppo", "cleanrl_ppo", "torchrl_ppo", "rllib_ppo")
"""Examples that come first; others follow by name."""


def page(folder: Path) -> str:
    """Return the page of the examples in a folder."""
    names = sorted(path.stem for path in folder.glob("*.py"))
    names.sort(key=lambda name: ORDER.index(name) if name in ORDER else len(ORDER))
    return INTRO + "".join(_entry(folder / f"{name}.py") for name in names)


def _entry(path: Path) -> str:
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return ENTRY.format(name=path.name, text=text)
