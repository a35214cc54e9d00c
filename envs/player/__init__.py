"""Recording of episodes, and web pages that replay them: `python -m lidarnaut.envs.player EPISODE`."""

from .page import build_page
from .recorder import EpisodeRecorder
from .recording import Recording

__all__ = ["EpisodeRecorder", "Recording", "build_page"]
