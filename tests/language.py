"""Count idioms that readers have to decode, in docstrings, comments, error messages and Markdown.

`python -m tests.language PATH...` prints each hit with its place, and the number of hits per 1,000 words.
"""

import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

IDIOMS = {
    "free relative": r"\b(?:what|whatever|whoever|whomever)\b(?!.*\?)|\bwhom\b",
    "who without a noun": r"(?:^|[,;:(]|\b(?:of|by|to|for|from|with|and|or))\s+who\b",
    "preposition + which": r"\b(?:of|by|from|to|among|beyond|under|beside) which\b",
    "but for": r"\bbut for\b",
    "tell": r"\b(?:tell|tells|told)\b",
    "in place of": r"\bin place of\b",
    "beside": r"\bbeside\b",
    "somebody": r"\b(?:some|any|no|every)body\b",
    "where for if": r"\bwhere (?:there (?:is|are)|it|they|nothing|none|nobody|somebody|one)\b",
    "comparison with one": r"\b(?:as|than) \w+ (?:as )?(?:one|those)\b|\bso (?:many|much|far) (?:as|that|of)\b",
    "by how much": r"\b(?:by|of|from|with) how (?:much|many|far|long|often|fast)\b",
    "neither": r"\b(?:neither|nothing else|none of (?:them|which))\b",
}
"""Regular expressions by the name of the idiom; case is ignored, and code in backticks is removed before."""
WORD = re.compile(r"[A-Za-z][A-Za-z'-]*")


def passages(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line number and text of prose in a Python or Markdown file."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        is_code = False
        for number, line in enumerate(text.splitlines(), start=1):
            if line.lstrip().startswith("```"):
                is_code = not is_code
            elif not is_code:
                yield number, re.sub(r"`[^`]*`|\]\([^)]*\)", " ", line)
        return
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            for offset, line in enumerate(node.value.value.splitlines()):
                yield node.lineno + offset, re.sub(r"`[^`]*`", " ", line)
        elif isinstance(node, ast.Raise) and node.exc is not None:
            for part in ast.walk(node.exc):
                if isinstance(part, ast.Constant) and isinstance(part.value, str):
                    yield part.lineno, part.value
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], re.sub(r"`[^`]*`", " ", token.string)


def count(*paths: Path) -> tuple[float, list[str]]:
    """Return the number of idioms per 1,000 words in files and folders, and a line for each hit."""
    hits, num_words = [], 0
    for path in (file for one in paths for file in (sorted(one.rglob("*.*")) if one.is_dir() else [one])):
        for number, text in passages(path) if path.suffix in (".py", ".md") else ():
            num_words += len(WORD.findall(text))
            for name, pattern in IDIOMS.items():
                found = re.findall(pattern, text, re.IGNORECASE)
                hits += [f"{path}:{number}: {name}: {' '.join(text.split())}"] * len(found)
    return 1000.0 * len(hits) / max(num_words, 1), hits


if __name__ == "__main__":
    rate, lines = count(*map(Path, sys.argv[1:]))
    sys.stdout.write("\n".join([*lines, f"{rate:.1f} per 1,000 words"]) + "\n")
