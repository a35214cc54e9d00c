"""Self-contained web page that replays recorded episodes."""

import base64
import gzip
import html
import json
from collections.abc import Sequence
from pathlib import Path
from string import Template

import numpy as np

from lidarnaut.envs.files import printable

from .recording import NO_RETURN, RANGE_STEPS, Recording

MAX_EPISODES = 2
SCRIPTS = ("data.js", "view.js", "panels.js", "plots.js", "player.js")


def build_page(recordings: Sequence[Recording]) -> str:
    """Return a self-contained HTML page that replays one or two episodes; ValueError for other numbers."""
    if not 1 <= len(recordings) <= MAX_EPISODES:
        raise ValueError(f"a page shows 1 to {MAX_EPISODES} episodes, got {len(recordings)}")
    names = ("page.html", "page.css", *SCRIPTS)
    texts = {name: Path(__file__).with_name(name).read_text(encoding="utf-8") for name in names}
    explorers = " and ".join(str(recording.about["explorer"]) or "an explorer" for recording in recordings)
    worlds = dict.fromkeys(str(recording.about["world"]) for recording in recordings)
    return Template(texts["page.html"]).substitute(
        title=html.escape(printable(f"{explorers} in {', '.join(worlds)}")),
        style=texts["page.css"],
        script="\n".join(texts[name] for name in SCRIPTS),
        data=base64.b64encode(pack(recordings)).decode(),
    )


def pack(recordings: Sequence[Recording]) -> bytes:
    """Return gzipped episodes for the script `data.js`: header length, JSON header, and arrays.

    The header lists per episode `about` (metadata) and `arrays`: [name, type, columns, byte offset, number of values].
    """
    episodes, parts, offset = [], [], 0
    for recording in recordings:
        arrays = recording.arrays
        # Differences compress better; `data.js` accumulates them.
        arrays["map_cells"] = np.diff(recording.map_cells, prepend=np.int32(0)).astype(np.int32)
        listed = []
        for name, array in arrays.items():
            content = array.astype(array.dtype.newbyteorder("<")).tobytes()
            content += bytes(-len(content) % 4)
            columns = array.shape[1] if array.ndim == 2 else 1
            listed.append([name, array.dtype.name, columns, offset, array.size])
            parts.append(content)
            offset += len(content)
        episodes.append({"about": recording.about, "arrays": listed})
    header = json.dumps({"episodes": episodes, "rangeSteps": RANGE_STEPS, "noReturn": NO_RETURN}).encode()
    header += b" " * (-len(header) % 4)
    return gzip.compress(b"".join([len(header).to_bytes(4, "little"), header, *parts]), compresslevel=6, mtime=0)
