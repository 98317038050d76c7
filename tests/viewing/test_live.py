"""Live viewers, without a display."""

import sys
import time
from importlib.util import find_spec
from types import SimpleNamespace

import newton.viewer
import numpy as np
import pytest
import torch

from aicpg_newton.engines.terrain import Ground, Terrain
from aicpg_newton.errors import UserError
from aicpg_newton.robot.humanoid import NUM_JOINTS
from aicpg_newton.viewing.desk import Desk, Restart, Turn
from aicpg_newton.viewing.live import LiveViewer


def pose(robots=1):
    """Root position, root rotation and joint angles of robots that stand upright."""
    position = torch.tensor([[0.0, 0.0, 0.88]]).repeat(robots, 1)
    rotation = torch.tensor([[0.0, 0.0, 0.0, 1.0]]).repeat(robots, 1)
    return position, rotation, torch.zeros(robots, NUM_JOINTS)


def test_unknown_viewer():
    """An unknown kind is refused with the kinds there are."""
    with pytest.raises(UserError, match="viser, gl, usd, none"):
        LiveViewer("screen")


@pytest.mark.parametrize(
    ("kind", "module", "package"),
    [
        ("viser", "viser", "viser"),
        ("gl", "pyglet", "pyglet"),
        ("usd", "pxr", "usd-core"),
    ],
)
def test_missing_package(monkeypatch, tmp_path, kind, module, package):
    """A viewer whose package is not installed says what to install."""
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(UserError, match=f"pip install.*{package}"):
        LiveViewer(kind, path=tmp_path / "a.usd")


class FakeViewer:
    """Stands for one of Newton's viewers and counts what it is shown."""

    def __init__(self, **_: object) -> None:
        self.url = "http://nowhere"
        self.times: list[float] = []
        self.closed = False
        self.pause = 0

    def set_model(self, model) -> None:
        """Take the model."""
        self.model = model

    def set_camera(self, *_: object, **__: object) -> None:
        """Ignore the camera."""

    def begin_frame(self, at) -> None:
        """Note the time."""
        self.times.append(at)

    def log_state(self, state) -> None:
        """Note the first link's position."""
        self.link = state.body_q.numpy()[0]

    def end_frame(self) -> None:
        """Do nothing."""

    def should_step(self) -> bool:
        """Go on when the pause is over, which every look at it shortens."""
        self.pause = max(0, self.pause - 1)
        return self.pause == 0

    def register_ui_callback(self, callback) -> None:
        """Take what draws a panel."""
        self.panel = callback

    def set_reset_callback(self, callback) -> None:
        """Take what Reset does."""
        self.reset = callback

    def is_running(self) -> bool:
        """Stop after 13 frames, as a window that is closed."""
        return len(self.times) < 13

    def close(self) -> None:
        """Note it."""
        self.closed = True


def fake(monkeypatch) -> None:
    """Let ``viser`` be a fake viewer."""
    monkeypatch.setattr("aicpg_newton.viewing.kinds.find_spec", lambda module: module)
    monkeypatch.setattr(newton.viewer, "ViewerViser", FakeViewer)
    monkeypatch.setattr(newton.viewer, "ViewerGL", FakeViewer)


def test_live_viewer_keeps_real_time(monkeypatch):
    """12 control steps take the 0.2 s that they simulate; time set back does not stall; closing closes."""
    fake(monkeypatch)
    with LiveViewer("viser", 2) as viewer:
        shown = viewer._viewer
        viewer.show(*pose(2), time=100.0)
        began = time.perf_counter()
        for step in range(1, 13):
            assert viewer.is_running()
            viewer.show(*pose(2), time=100.0 + step / 60)
        assert 0.19 < time.perf_counter() - began < 0.6
        assert not viewer.is_running()
        began = time.perf_counter()
        viewer.show(*pose(2), time=0.0)
        assert time.perf_counter() - began < 0.1
        assert shown.model.body_count == 2 * 13 + 1 and len(shown.times) == 14
    assert shown.closed


def test_a_paused_viewer_holds_the_simulation(monkeypatch):
    """The same step is shown again until the pause is over, and then once each."""
    fake(monkeypatch)
    with LiveViewer("gl", 1) as viewer:
        viewer._viewer.pause = 4
        viewer.show(*pose(), time=1.0)
        viewer.show(*pose(), time=2.0)
        assert viewer._viewer.times == [1.0, 1.0, 1.0, 1.0, 2.0]


def test_a_slider_in_a_window(monkeypatch):
    """It is drawn with its value and ends, and asks for another frequency when it is moved, not before; Reset too."""
    fake(monkeypatch)
    desk = Desk(frequencies=[0.9], lowest=0.7, highest=1.5)
    drawn = []

    def slider_float(*arguments) -> tuple[bool, float]:
        drawn.append(arguments)
        return len(drawn) == 2, 1.2 if len(drawn) > 1 else 0.9

    with LiveViewer("gl", 1, desk=desk) as viewer:
        for wishes in ([], [Turn(1.2)], []):
            viewer._viewer.panel(SimpleNamespace(slider_float=slider_float))
            assert list(desk.asked()) == wishes
        viewer._viewer.reset()
    assert [arguments[:4] for arguments in drawn] == [("f [Hz]", value, 0.7, 1.5) for value in (0.9, 0.9, 1.2)]
    assert list(desk.asked()) == [Restart()]


def test_display_that_cannot_be_opened(monkeypatch):
    """A viewer that fails to open says why and what to choose instead."""
    fake(monkeypatch)

    def fail(**_: object) -> None:
        raise RuntimeError("no display")

    monkeypatch.setattr(newton.viewer, "ViewerGL", fail)
    with pytest.raises(UserError, match=r"no display.*viser"):
        LiveViewer("gl")


def test_live_viewer_shows_terrain(monkeypatch):
    """The model that a viewer is given has the terrain's triangles on a body that slides, in two tones."""
    fake(monkeypatch)
    terrain = Terrain.make(Ground(height_range=0.1, length=24.0, width=16.0))
    assert terrain is not None
    with LiveViewer("viser", 2, terrain=terrain) as viewer:
        shown = viewer._viewer
        viewer.show(*pose(2), time=0.0)
    mesh = shown.model.shape_source[-1]
    assert np.allclose(mesh.vertices, terrain.vertices()) and np.array_equal(mesh.indices, terrain.triangles().ravel())
    assert shown.model.body_count == 2 * 13 + 1
    # Texture coordinates: two by two cells of one metre make one image.
    corner = np.nonzero((mesh.vertices[:, 0] == 4.0) & (mesh.vertices[:, 1] == -2.0))[0]
    assert mesh.uvs[corner].tolist() == [[2.0, -1.0]]
    assert len(np.unique(mesh.texture[:, :, 0])) == 2 and mesh.texture[0, 0, 0] != mesh.texture[0, -1, 0]


def test_no_viewer_shows_nothing():
    """The kind ``none`` accepts everything, keeps running and does not wait."""
    with LiveViewer("none") as viewer:
        began = time.perf_counter()
        for step in range(60):
            viewer.show(*pose(), time=float(step))
        assert time.perf_counter() - began < 1.0
        assert viewer.is_running()


@pytest.mark.skipif(find_spec("pxr") is None, reason="usd-core is not installed")
def test_usd_writes_a_file(tmp_path):
    """The usd viewer writes its file when it is closed, and needs a path for that."""
    with pytest.raises(UserError, match="give its path"):
        LiveViewer("usd")
    path = tmp_path / "walk.usd"
    with LiveViewer("usd", path=path) as viewer:
        for step in range(3):
            viewer.show(*pose(), time=step / 60)
    assert path.stat().st_size > 1000
