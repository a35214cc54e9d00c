"""Episodes as files, and as pages that show them in a browser: `python -m lidarnaut.envs.player EPISODE`."""

from .page import build_page
from .recorder import EpisodeRecorder
from .recording import Recording

__all__ = ["EpisodeRecorder", "Recording", "build_page"]
