"""Maps and YAML files by Pillow, OpenCV and ruamel.yaml."""

import json
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, PngImagePlugin
from ruamel.yaml import YAML

MAP_SAVER = (
    "image: {image}\nresolution: {resolution:.6f}\norigin: [{origin[0]:.6f}, {origin[1]:.6f}, 0.000000]\nnegate: 0\n"
    "occupied_thresh: 0.65\nfree_thresh: 0.196\n\n"
)
NAV2 = (
    "image: {image}\nmode: trinary\nresolution: {resolution}\norigin: [{origin[0]}, {origin[1]}, 0]\nnegate: 0\n"
    "occupied_thresh: 0.65\nfree_thresh: 0.25"
)
EXPONENTS = (
    "image: {image}\nresolution: 5e-2\norigin: [-1.25e0, 25e-1, 0e0]\nnegate: no\noccupied_thresh: 65e-2\n"
    "free_thresh: .196\n"
)


def read(library, image, file):
    """Return the pixels of a saved map, grey or grey with transparency, and the content of its YAML file."""
    pixels = np.asarray(Image.open(image)) if library == "pillow" else cv2.imread(image, cv2.IMREAD_UNCHANGED)
    if library != "pillow" and pixels.ndim == 3:  # it has no grey images with transparency: blue, green, red, alpha
        pixels = pixels[..., [0, 3]]
    return {"pixels": pixels.tolist(), "yaml": YAML(typ="safe").load(Path(file))}


def write(folder, classes, resolution, origin):
    """Write a map in the styles of other programs; return the YAML files by style.

    `classes`: "free", "occupied" or "unknown" for each cell, top row first.
    """
    found, classes = {}, np.array(classes)

    def grey(free=254, occupied=0, unknown=205, dtype=np.uint8):
        return np.select([classes == "free", classes == "occupied"], [free, occupied], unknown).astype(dtype)

    def add(name, suffix, save, text=None, **changes):
        path = Path(folder) / f"{len(found)}.{suffix}"
        save(path)
        content = {"image": path.name, "resolution": resolution, "origin": [*origin, 0.0]}
        content |= {"negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.196} | changes
        with (file := path.with_suffix(".yaml")).open("w") as out:
            out.write(text.format(**content)) if text else YAML().dump(content, out)
        found[name] = str(file)

    def by_pillow(pixels, **options):
        return lambda path: Image.fromarray(pixels).save(path, **options)

    def by_opencv(pixels, *options):
        return lambda path: cv2.imwrite(str(path), pixels, options)

    header = f"P5\n# CREATOR: map_saver.cpp 0.050 m/pix\n{classes.shape[1]} {classes.shape[0]}\n255\n".encode()
    add("map_saver of ROS 1", "pgm", lambda path: path.write_bytes(header + grey().tobytes()), MAP_SAVER)
    add("map_saver of Nav2, free_thresh 0.25", "pgm", by_pillow(grey()), NAV2)
    add("numbers with exponents, `negate: no`", "pgm", by_pillow(grey()), EXPONENTS)
    add("plain PGM by OpenCV", "pgm", by_opencv(grey(), cv2.IMWRITE_PXM_BINARY, 0))
    add("PNG of 16 bits by OpenCV", "png", by_opencv(grey(65278, 0, 52685, np.uint16)))
    add("PNG in colours by OpenCV", "png", by_opencv(cv2.cvtColor(grey(), cv2.COLOR_GRAY2BGR)))
    add("PNG with a palette by Pillow", "png", lambda path: Image.fromarray(grey()).convert("P").save(path))
    gamma = PngImagePlugin.PngInfo()
    gamma.add(b"gAMA", (45455).to_bytes(4, "big"))
    add("PNG with a gamma, as GIMP exports", "png", by_pillow(grey(255), pnginfo=gamma))
    add("negated BMP by Pillow", "bmp", by_pillow(255 - grey()), negate=1)
    clear = {"mode": "scale", "occupied_thresh": 0.9, "free_thresh": 0.1}
    add("transparent unknown cells", "png", by_pillow(np.dstack([grey(255, 0, 255), grey(255, 255, 0)])), **clear)
    add("mode raw", "png", by_pillow(grey(0, 100, 255)), mode="raw")
    add("TIFF by OpenCV", "tiff", by_opencv(grey()))
    return found


def write_yaml(source, folder):
    """Write a YAML file in other styles; return the paths by style."""
    folder, content, found = Path(folder), YAML(typ="safe").load(Path(source)), {}
    for style in ("default_flow_style", "canonical", "explicit_start", "allow_unicode"):
        yaml = YAML(typ="safe")
        setattr(yaml, style, True)
        found[f"ruamel.yaml, {style}"] = str(folder / f"{style}.yaml")
        yaml.dump(content, folder / f"{style}.yaml")
    (folder / "json.yaml").write_text(json.dumps(content, indent=1))
    return found | {"JSON": str(folder / "json.yaml")}
