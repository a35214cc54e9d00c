"""Rendering of episodes to arrays or a window."""

import os
from typing import Any

import numpy as np

from .scene import Scene

SIZE = (1280, 720)
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # keeps standard output clean
_INVISIBLE_DRIVERS = ("dummy", "offscreen")


def _open_window(title: str) -> Any:
    """Open a `pygame.Window` of the size of pictures; RuntimeError without display and `SDL_VIDEODRIVER`."""
    import pygame

    was_on = pygame.display.get_init()
    try:
        pygame.display.init()
        if pygame.display.get_driver() in _INVISIBLE_DRIVERS and not os.environ.get("SDL_VIDEODRIVER"):
            raise pygame.error("no X11 or Wayland display was found")
    except pygame.error as error:
        if not was_on:
            pygame.display.quit()
        raise RuntimeError(
            f"cannot open a window: {error}; run it in a desktop session (DISPLAY or WAYLAND_DISPLAY set), draw with "
            "render_mode='rgb_array', or set SDL_VIDEODRIVER=dummy for an invisible window"
        ) from error
    return pygame.Window(title, SIZE)


class Renderer:
    """Renderer of episodes: `human` to a window at a fixed rate, `rgb_array` to arrays without display."""

    def __init__(self, mode: str, fps: float) -> None:
        """Create a renderer; `fps`: maximum rate of the window [Hz]."""
        self.mode, self.fps = mode, fps
        self._picture: Any = None
        self._window: Any = None
        self._clock: Any = None

    def draw(self, scene: Scene, title: str = "lidarnaut") -> np.ndarray | None:
        """Draw a scene (moment of an episode); return an image, shape (height, width, 3), uint8, or None for `human`.

        `title`: title of the window. RuntimeError for `human` without display.
        """
        import pygame

        from .picture import Picture

        if self._picture is None:
            self._picture = Picture(SIZE)
        if self.mode == "rgb_array":
            pixels = pygame.image.tobytes(self._picture.paint(scene), "RGB")
            return np.frombuffer(pixels, dtype=np.uint8).reshape(SIZE[1], SIZE[0], 3).copy()
        if self._window is None:
            self._window = _open_window(title)
            self._clock = pygame.Clock()
        self._window.title = title
        self._window.get_surface().blit(self._picture.paint(scene), (0, 0))
        self._window.flip()
        pygame.event.pump()
        self._clock.tick(self.fps)
        return None

    def close(self) -> None:
        if self._window is not None:
            self._window.destroy()
        self._window = self._clock = self._picture = None
