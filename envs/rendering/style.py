"""Colors and fonts of pictures: ground truth is blue, estimates are vermilion.

Palette of Okabe and Ito, "Color Universal Design" (2008).
"""

Colour = tuple[int, int, int]

PAPER: Colour = (246, 247, 249)
INK: Colour = (32, 40, 51)
MUTED: Colour = (103, 114, 129)
RULE: Colour = (205, 211, 219)

TRUE: Colour = (0, 114, 178)
ESTIMATED: Colour = (213, 94, 0)
PLAN: Colour = (170, 51, 119)
FRONTIER: Colour = (0, 158, 115)
NODE: Colour = (222, 205, 190)
LOOP: Colour = (204, 121, 167)
LIDAR: Colour = (86, 180, 233)
SEEN_ALPHA, BEAM_ALPHA = 70, 130
"""Opacity of the scanned area and of lidar beams, from 0 to 255."""
GLOBAL_TREE: Colour = (120, 150, 215)
LOCAL_TREE: Colour = (204, 150, 20)
PREDICTED: Colour = (240, 228, 66)
TOUR: Colour = (204, 121, 167)
COSTS: tuple[Colour, ...] = ((253, 231, 37), (94, 201, 98), (33, 145, 140), (59, 82, 139), (68, 1, 84))
"""Colors of tested poses from the lowest to the highest cost, from the color map viridis."""
PERSON: Colour = (230, 159, 0)

FLOOR: Colour = (255, 255, 255)
SOLID: Colour = (122, 133, 147)
WALL: Colour = (46, 56, 69)
OUTSIDE: Colour = (226, 230, 235)
LEFT_OUT: Colour = (238, 214, 175)
"""Color of free map cells that are not connected to the robot's start."""
FREE: Colour = (255, 255, 255)
OCCUPIED: Colour = (30, 36, 46)
UNKNOWN: Colour = (176, 187, 201)

SMALL, BODY, LARGE = 13, 14, 22
