"""Signatures of the API pages: types without limits, and values of constants."""

import re
import sys
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx

MAX_VALUE = 60
"""Maximum length of a shown value of a constant or attribute."""
ANNOTATED = re.compile(
    r"(?:~?\w+\.)*Annotated\[([~\w.]+(?:\[[^\[\]]*\])?(?: \| None)?), "
    r"(?!~?numpy\.|u?int\d|float\d)(?:[^\[\]]|\[[^\[\]]*\])*\]"
)
"""A type with limits, such as `Annotated[float, Gt(gt=0)]`; not arrays with their type and shape."""


def plain(text: str) -> str:
    """Return the text of a type or signature without limits."""
    return ANNOTATED.sub(r"\1", text)


def process_signature(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, signature: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    """Simplify types, and replace constants that are numbers or texts by their values."""
    known = vars(sys.modules.get(getattr(obj, "__module__", None) or "", sys))

    def value(found: re.Match[str]) -> str:
        constant = known.get(found[0])
        text = repr(constant)
        return text if isinstance(constant, str | int | float | tuple) and len(text) <= MAX_VALUE else found[0]

    if signature:
        # Names of constants have at least three letters, unlike type variables.
        signature = re.sub(r"(?<![\w.'\"])[A-Z][A-Z0-9_]{2,}\b(?!['\"\w.])", value, plain(signature))
    return signature, returned and plain(returned)


def simplify_attributes(app: Sphinx, doctree: nodes.document) -> None:
    """Simplify types of attributes, and leave out long values."""
    for node in list(doctree.findall(addnodes.desc_annotation)):
        text = node.astext()
        if text.startswith(" = ") and (len(text) > MAX_VALUE or "<" in text):
            node.parent.remove(node)
        elif text.startswith(": ") and "Annotated[" in text:
            node[:] = [
                addnodes.desc_sig_punctuation("", ":"),
                addnodes.desc_sig_space(),
                nodes.inline("", plain(text.removeprefix(": "))),
            ]
    for node in doctree.findall(nodes.paragraph):
        if (text := node.astext()).startswith("alias of Annotated["):
            node[:] = [nodes.Text(plain(text))]


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the extension."""
    app.connect("autodoc-process-signature", process_signature)
    app.connect("doctree-read", simplify_attributes)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
