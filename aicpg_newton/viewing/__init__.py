"""Seeing the humanoid: recordings and filmstrips without a display, and live viewers.

Everything here takes poses (root position, root rotation, joint angles) and knows neither engines nor environments, so
that a simulation, a motion capture clip and a made-up movement are shown in the same way.
"""

from aicpg_newton.viewing.desk import Desk, Readings
from aicpg_newton.viewing.filmstrip import FilmstripRow, save_filmstrip
from aicpg_newton.viewing.live import LIVE_KINDS, VIEWER_KINDS, LiveViewer
from aicpg_newton.viewing.stage import Stage
from aicpg_newton.viewing.video import VideoWriter

__all__ = [
    "LIVE_KINDS",
    "VIEWER_KINDS",
    "Desk",
    "FilmstripRow",
    "LiveViewer",
    "Readings",
    "Stage",
    "VideoWriter",
    "save_filmstrip",
]
