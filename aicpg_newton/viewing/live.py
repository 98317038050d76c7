"""Live viewers: Newton's viewers behind one small door."""

from __future__ import annotations

import time as clock
import webbrowser
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import newton.viewer
import torch
import warp as wp

from aicpg_newton.engines.terrain import Terrain
from aicpg_newton.errors import UserError
from aicpg_newton.robot.humanoid import CONTROL_RATE
from aicpg_newton.viewing.desk import Desk, Readings, Restart, Turn
from aicpg_newton.viewing.kinds import LIVE_KINDS, VIEWER_KINDS, has_screen, missing_packages
from aicpg_newton.viewing.output import writable_path
from aicpg_newton.viewing.page import Panel
from aicpg_newton.viewing.stage import Floor, Stage

_PAUSE = 1.0 / 30.0
"""Time between two looks at a paused viewer's panel [s]."""

_PACE_STEPS = round(CONTROL_RATE)
"""Control steps over which the pace is taken: a second."""


class LiveViewer:
    """Shows poses while they are computed, one second of simulation in one second of time.

    On a plane, robots of different environments stand side by side, robot 0 at the left of the direction of travel; on
    a terrain they are where they are. In ``viser`` and ``gl`` they are on :attr:`Floor.TREADMILL`, so that
    robot 0 stays in the picture while the user is free to turn the camera; ``usd`` keeps world positions.

    Args:
        kind: One of :data:`VIEWER_KINDS`.
        num_robots: Number of humanoids shown.
        path: File that ``usd`` writes, ending in ``.usd``; unused by the others.
        terrain: Shape of the ground; None for a plane.
        desk: Where the viewer's panel sends wishes; None for no panel. In ``viser`` that is all that a desk offers, in
            ``gl`` a slider for the stride frequency of all robots, and Reset.

    Raises:
        UserError: The kind is unknown, its package is not installed, there is no display or no path.
    """

    def __init__(
        self,
        kind: str,
        num_robots: int = 1,
        path: Path | str | None = None,
        terrain: Terrain | None = None,
        desk: Desk | None = None,
    ) -> None:
        if kind not in VIEWER_KINDS:
            raise UserError(f"there is no viewer '{kind}'; choose one of {', '.join(VIEWER_KINDS)}")
        if num_robots < 1:
            raise UserError(f"a viewer of {num_robots} robots is not possible; give at least 1")
        missing = missing_packages(kind)
        if missing:
            raise UserError(f"the {kind} viewer needs packages not installed; run: pip install {' '.join(missing)}")
        file = None
        if kind == "usd":
            if path is None:
                raise UserError("the usd viewer writes a file; give its path, ending in .usd")
            file = writable_path(path, ".usd")
        self._paced = kind in LIVE_KINDS
        self._viewer: Any = None
        self._started: tuple[float, float] | None = None
        self._panel: Panel | None = None
        self._moments: deque[tuple[float, float]] = deque(maxlen=_PACE_STEPS)
        if kind == "none":
            return
        self._viewer = _open(kind, file)
        self._num_robots, self._floor = num_robots, Floor.FIXED if kind == "usd" else Floor.TREADMILL
        self.stand_on(terrain)
        if desk is not None and kind in LIVE_KINDS:
            self._viewer.set_reset_callback(lambda: desk.ask(Restart()))
            if kind == "viser":
                self._panel = Panel(self._viewer.server.gui, desk)
            elif desk.frequencies:
                self._viewer.register_ui_callback(_slider(desk))

    def stand_on(self, terrain: Terrain | None) -> None:
        """Put the robots on this ground; None for a plane."""
        if self._viewer is None:
            return
        self._stage = Stage(self._num_robots, floor=self._floor, terrain=terrain)
        self._viewer.set_model(self._stage.model)
        # From the front right, slightly above; the distance lets all lanes fit.
        distance = 3.2 + 1.0 * (self._num_robots if terrain is None else 1)
        self._viewer.set_camera(wp.vec3(0.55 * distance, -0.83 * distance, 1.6), pitch=-10.0, yaw=123.0)

    def show(
        self,
        root_position: torch.Tensor,
        root_rotation: torch.Tensor,
        joint_position: torch.Tensor,
        time: float,
        readings: Readings | None = None,
    ) -> None:
        """Show one control step, and wait until its time has come, or for as long as the viewer is paused.

        Args:
            root_position: Pelvis positions [m], shape [n, 3] with n >= num_robots; more are ignored.
            root_rotation: Pelvis rotations (x, y, z, w), shape [n, 4].
            joint_position: Joint angles [rad], shape [n, 28].
            time: Simulated time [s].
            readings: What the panel shows, where there is one.
        """
        if self._viewer is None:
            return
        self._stage.pose(root_position, root_rotation, joint_position)
        self._draw(time)
        if self._paced:
            self._wait(time)
        if self._panel is not None and readings is not None:
            self._panel.show(readings, self._pace(time))
        while not self._viewer.should_step() and self._viewer.is_running():
            clock.sleep(_PAUSE)
            self._draw(time)

    def _draw(self, time: float) -> None:
        self._viewer.begin_frame(time)
        self._viewer.log_state(self._stage.state)
        self._viewer.end_frame()

    def _wait(self, time: float) -> None:
        now = clock.perf_counter()
        if self._started is not None:
            ahead = (time - self._started[0]) - (now - self._started[1])
            if 0.0 <= ahead < 1.0:
                clock.sleep(ahead)
                return
        # The first step, time set back, or a machine that does not keep up: start counting from here.
        self._started = (time, now)

    def _pace(self, time: float) -> float:
        """Simulated time that has passed in a second of real time, over the last steps; 1 where nothing is known."""
        moments = self._moments
        if moments and not 0.0 < time - moments[-1][0] < 2.0 / CONTROL_RATE:
            moments.clear()  # time was set back
        moments.append((time, clock.perf_counter()))
        (began, began_at), (now, now_at) = moments[0], moments[-1]
        return (now - began) / (now_at - began_at) if len(moments) == moments.maxlen else 1.0

    def is_running(self) -> bool:
        """Whether somebody may still be looking: False once a window is closed."""
        return self._viewer is None or bool(self._viewer.is_running())

    def close(self) -> None:
        """Close the viewer; ``usd`` writes its file."""
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None

    def __enter__(self) -> LiveViewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _slider(desk: Desk) -> Callable[[Any], None]:
    """What draws a slider for the stride frequency of all robots into a window's panel."""
    value = desk.frequencies[0]

    def draw(panel: Any) -> None:
        nonlocal value
        changed, value = panel.slider_float("f [Hz]", value, desk.lowest, desk.highest, "%.2f")
        if changed:
            desk.ask(Turn(value))

    return draw


def _open(kind: str, path: Path | None) -> Any:
    try:
        if kind == "viser":
            # This machine only: a server in the cloud is reached through an SSH tunnel, not from everywhere.
            viewer = newton.viewer.ViewerViser(host="127.0.0.1", label="AI-CPG", verbose=False)
            print(f"viewer: open {viewer.url} in a browser", flush=True)
            if has_screen():
                webbrowser.open(viewer.url)
            return viewer
        if kind == "gl":
            return newton.viewer.ViewerGL(width=1280, height=720)
        return newton.viewer.ViewerUSD(str(path), fps=round(CONTROL_RATE), num_frames=None)
    except Exception as error:  # OpenGL and servers raise many types
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise UserError(
            f"the {kind} viewer cannot be opened here ({reason}); without a display choose viser, usd or a recording"
        ) from error
