"""What play.py can be told."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, Self

from aicpg_newton.ranges import ENVIRONMENTS, SEED, Range, check_ranges
from aicpg_newton.robot.humanoid import CONTROL_DT, CONTROL_RATE
from aicpg_newton.viewing.kinds import LIVE_KINDS, has_screen, missing_packages
from aicpg_newton.viewing.output import writable_path

FREQUENCIES = (0.9, 1.1, 1.3)
"""Stride frequencies when none is given [Hz]."""

_DURATION, _LIVE_DURATION = 10.0, 3600.0
"""Simulated time when none is given [s]."""


@dataclass(kw_only=True)
class PlayOptions:
    """What to play and where to see it."""

    checkpoint: Path | None = None
    """Trained network: a model_*.pt or a run folder; the best of those that ship when not given."""
    task: str | None = None
    """Task to play on, flat, uneven or robust; by default the checkpoint's own, and flat without a checkpoint."""
    terrain_seed: Annotated[int | None, SEED] = None
    """Seed of uneven ground; 1000 when not given, which no training takes by itself."""
    frequency: Annotated[tuple[float, ...], Range(0.0, 10.0, positive=True)] = ()
    """Stride frequencies f [Hz], 0.9, 1.1 and 1.3 when not given; the environments are shared out evenly among them."""
    num_envs: Annotated[int | None, ENVIRONMENTS] = None
    """Number of robots; when not given 12, and in a live viewer one for each frequency."""
    duration: Annotated[float | None, Range(CONTROL_DT, 1e6)] = None
    """Simulated time [s]; when not given 10, and in a live viewer an hour, which Ctrl-C ends."""
    agent: Literal["policy", "zero", "random", "mocap"] = "policy"
    """policy: the trained network; zero: the CPG alone; random: noise on it; mocap: the gait on a plane, no physics."""
    viewer: Literal["auto", "viser", "gl", "usd", "none"] = "auto"
    """viser: a page in the browser to turn f, push, and change the ground; gl: a window with a slider for f; usd writes
    play.usd. auto: if nothing is to be written, the page, or a recording on a machine without a screen."""
    record: Path | None = None
    """Write an mp4 of the first environment."""
    filmstrip: Path | None = None
    """Write a PNG of one stride per frequency, in eight poses; of one second where no frequency sets the stride."""
    device: str = "auto"
    """auto, cpu or cuda:N."""
    engine: str = "auto"
    """newton, mujoco, or auto: newton on CUDA and mujoco on a CPU."""
    seed: Annotated[int, SEED] = 0
    """Seed of start states and of the random agent."""

    @property
    def robots(self) -> int:
        """Number of robots."""
        if self.num_envs is not None:
            return self.num_envs
        return max(1, len(self.frequency or FREQUENCIES)) if self.viewer in LIVE_KINDS else 12

    def settled(self) -> Self:
        """The same with what ``auto`` stands for on this machine."""
        if self.viewer != "auto":
            return self
        if self.record is not None or self.filmstrip is not None:
            return replace(self, viewer="none")
        if has_screen():
            missing = missing_packages("viser")
            if not missing:
                return replace(self, viewer="viser")
            print(f"The page to turn, push and watch it needs: pip install {' '.join(missing)}")
        return replace(self, viewer="none", record=_free_name(Path("play.mp4")))

    def steps(self) -> int:
        """Number of control steps, once all options make sense.

        Raises:
            UserError: One does not, or a file cannot be written.
        """
        check_ranges(self, "--")
        duration = self.duration
        if duration is None:
            watched = self.viewer in LIVE_KINDS and self.record is None and self.filmstrip is None
            duration = _LIVE_DURATION if watched else _DURATION
        for path, suffix in ((self.filmstrip, ".png"), (self.record, ".mp4")):
            if path is not None:
                writable_path(path, suffix)
        return round(duration * CONTROL_RATE)


def _free_name(path: Path) -> Path:
    """The path, with a number behind it if there is such a file already."""
    name, number = path, 2
    while name.exists():
        name = path.with_stem(f"{path.stem}_{number}")
        number += 1
    return name
