"""The page without a server: its ground, its build, and the humanoid in a browser."""

# The type checker cannot see into MuJoCo's compiled module.
# pyright: reportAttributeAccessIssue=false
import functools
import http.server
import json
import os
import shutil
import subprocess
import threading
from pathlib import Path

import mujoco
import numpy as np
import pytest

from aicpg_newton.engines.interface import Physics
from aicpg_newton.engines.mujoco import MujocoEngine
from aicpg_newton.engines.terrain import Ground
from aicpg_newton.env.registry import get_task
from aicpg_newton.errors import UserError
from aicpg_newton.export import requirements, web
from aicpg_newton.export.__main__ import ExportOptions, export
from aicpg_newton.export.model import stock_model
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.playing.options import PlayOptions
from aicpg_newton.playing.play import play
from aicpg_newton.robot import humanoid

GROUND = Ground(height_range=0.1, length=10.0, width=8.0, seed=5)


def test_endless_ground_repeats_itself_and_is_no_steeper():
    """Each period is the one before, also across the seam."""
    ground = web.endless(GROUND)
    heights, period = ground.heights.numpy(), (40, 32)
    assert heights.shape == (81, 65) and ground.extent == (20.0, 16.0)
    for axis, length in enumerate(period):
        first, second = np.split(heights.take(range(2 * length), axis), 2, axis)
        np.testing.assert_array_equal(first, second)
        # Random heights are two cells apart, with straight lines between them.
        assert np.abs(np.diff(heights, axis=axis)).max() <= 0.5 * GROUND.height_range + 1e-6


def test_the_stock_model_has_the_engines_ground():
    """Its heights come back from the file as they went in."""
    engine = MujocoEngine(1, "cpu", humanoid.motors(), Physics(), web.endless(GROUND))
    model = mujoco.MjModel.from_xml_string(stock_model(engine, humanoid.motors(), PatternNetwork.load()))
    np.testing.assert_allclose(model.hfield_data, engine.model.hfield_data, atol=1e-4)
    np.testing.assert_allclose(model.hfield_size, engine.model.hfield_size, rtol=1e-5)
    assert model.ngeom == engine.model.ngeom and model.opt.disableflags == engine.model.opt.disableflags


def test_without_node(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """One sentence, and nothing is made."""
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(UserError, match=r"built with Node\.js and npm, which are not here"):
        export(ExportOptions(web=tmp_path / "page"))
    assert not (tmp_path / "page").exists()


def test_without_its_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """As in a wheel."""
    monkeypatch.setattr(requirements, "SOURCE", tmp_path / "web")
    with pytest.raises(UserError, match="not part of the installed package; give --web in a checkout"):
        export(ExportOptions(web=tmp_path / "page"))


@pytest.mark.slow
def test_it_walks_and_runs_in_a_browser(tmp_path: Path):
    """20 s at 0.9 Hz and 20 s at 1.3 Hz without a fall, as fast as play.py within 5 %; nothing comes from elsewhere."""
    browser = os.environ.get("CHROMIUM") or shutil.which("chromium")
    if browser is None or shutil.which("node") is None or shutil.which("npm") is None:
        pytest.skip("it takes chromium, node and npm")
    page = tmp_path / "page"
    export(ExportOptions(web=page))
    assert sum(file.stat().st_size for file in page.iterdir()) < 25e6
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(page))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{server.server_port}/"
        command = ["node", str(web.SOURCE / "drive.mjs"), url, str(tmp_path)]
        environment = {**os.environ, "CHROMIUM": browser}
        result = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=1200)
        server.shutdown()
    assert result.returncode == 0, result.stderr
    found = json.loads(result.stdout)
    print(found)
    assert found["errors"] == []
    assert found["paused"] == 0
    options = PlayOptions(frequency=(0.9, 1.3), num_envs=8, duration=20.0, device="cpu", viewer="none")
    tally = play(options, get_task("flat"))
    speeds = {"walk": tally.speed(0), "run": tally.speed(4)}
    for name, gait in (("walk", "Walking"), ("run", "Running")):
        assert found[name]["falls"] == 0 and found[name]["gait"] == gait
        assert found[name]["mean"] == pytest.approx(speeds[name], rel=0.05)
    assert found["uneven"]["distance"] > 5 and found["uneven"]["now"] == 1.1
    assert all((tmp_path / f"{name}.png").stat().st_size > 20_000 for name in ("walk", "run", "uneven", "push"))
