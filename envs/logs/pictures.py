"""Pictures of maps with the robot's path."""

import numpy as np
from PIL import Image, ImageDraw

from envs.geometry import UNKNOWN, OccupancyGrid


def picture(grid: OccupancyGrid, positions: np.ndarray | None = None, margin: int = 10) -> Image.Image:
    """Draw a map, cropped to what is known and a margin [cells]: white free, black occupied, grey unknown.

    The path in blue goes through `positions`, shape (n, 2), in the map frame [m].
    """
    known = grid.data != UNKNOWN
    rows, cols = np.nonzero(known if known.any() else ~known)
    height, width = grid.data.shape
    top, bottom = max(rows.min() - margin, 0), min(rows.max() + margin + 1, height)
    left, right = max(cols.min() - margin, 0), min(cols.max() + margin + 1, width)
    cells = grid.data[top:bottom, left:right].astype(float)
    grey = np.where(cells == UNKNOWN, 190.0, 255.0 - 2.55 * cells).round().astype(np.uint8)
    image = Image.fromarray(np.ascontiguousarray(grey[::-1])).convert("RGB")
    if positions is not None:
        corner = np.array(grid.origin) + np.array([left, top]) * grid.resolution
        points = (positions - corner) / grid.resolution
        points[:, 1] = bottom - top - points[:, 1]
        ImageDraw.Draw(image).line([tuple(point) for point in points.tolist()], fill=(40, 90, 220))
    return image
