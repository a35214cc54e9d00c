#!/usr/bin/env bash
# opencv 5.0.0: imread scales the values of a PGM map in text (P2) by the maximum of its header, in binary (P5) not.
#
# The maximum is white: with 100, as for probabilities in percent, a value of 100 is 255 in 8 bits. Pillow scales both
# kinds. OpenCV reads the same image from the binary file as 0, 50, 100: free cells of a map are then unknown,
# (255 - 100) / 255 = 0.61 with the usual thresholds 0.25 and 0.65. A map for OpenCV has the maximum 255.
#
# Seen: {"text": {"opencv": [0, 127, 255], "pillow": [0, 128, 255]},
#        "binary": {"opencv": [0, 50, 100], "pillow": [0, 128, 255]}}
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-python-headless==5.0.0.93 pillow==13.0.0 numpy==2.4.6
"$folder/venv/bin/python" - "$folder/map.pgm" <<'PYTHON'
import json
import sys
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

path, found = sys.argv[1], {}
for name, content in (("text", b"P2\n3 1\n100\n0 50 100\n"), ("binary", b"P5\n3 1\n100\n" + bytes([0, 50, 100]))):
    Path(path).write_bytes(content)
    [row] = cv2.imread(path, cv2.IMREAD_GRAYSCALE).tolist()
    [other] = np.asarray(Image.open(path)).tolist()
    found[name] = {"opencv": row, "pillow": other}
print(json.dumps(found))
expected = {
    "text": {"opencv": [0, 127, 255], "pillow": [0, 128, 255]},
    "binary": {"opencv": [0, 50, 100], "pillow": [0, 128, 255]},
}
sys.exit(found != expected)
PYTHON
