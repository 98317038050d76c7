"""A full disk, which a limit on the size of files stands for, and a temporary folder that takes nothing."""

import errno
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import torch

from aicpg_newton.engines.interface import Physics
from aicpg_newton.engines.mujoco import MujocoEngine
from aicpg_newton.env.registry import get_task
from aicpg_newton.errors import UserError, run_command
from aicpg_newton.learning import checkpoint
from aicpg_newton.learning.plan import RunOptions
from aicpg_newton.learning.training import train
from aicpg_newton.playing.options import PlayOptions
from aicpg_newton.playing.play import play
from aicpg_newton.robot.humanoid import NUM_JOINTS, motors
from aicpg_newton.viewing.filmstrip import FilmstripRow, save_filmstrip
from aicpg_newton.viewing.video import VideoWriter

resource = pytest.importorskip("resource", reason="this system has no limits on the size of files")


@contextmanager
def limit(size: int) -> Iterator[None]:
    """No file may grow beyond this size [bytes] meanwhile: not for longer, as tests report into one, too."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def pose(rows: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Upright robots."""
    upright = torch.tensor([0.0, 0.0, 0.0, 1.0]).repeat(rows, 1)
    return torch.tensor([0.0, 0.0, 0.88]).repeat(rows, 1), upright, torch.zeros(rows, NUM_JOINTS)


@pytest.mark.parametrize("size", [100, 4000], ids=["at once", "in the middle"])
def test_a_recording(size: int, tmp_path: Path):
    """The encoder is another process, which says little; a recording of before stays."""
    path = tmp_path / "walk.mp4"
    path.write_bytes(b"of before")
    generator = torch.Generator().manual_seed(0)
    refused = pytest.raises(UserError, match=r"cannot write .*walk.mp4 .*; make room")
    with refused, limit(size), VideoWriter(path) as video:
        for _ in range(40):
            position, rotation, joints = pose(1)
            video.add(position, rotation, joints + torch.rand(1, NUM_JOINTS, generator=generator))
    assert {each.name: each.read_bytes() for each in tmp_path.iterdir()} == {"walk.mp4": b"of before"}


def test_a_filmstrip(tmp_path: Path):
    """The picture of before stays."""
    path = tmp_path / "strides.png"
    path.write_bytes(b"of before")
    with pytest.raises(UserError, match=r"cannot write .*strides.png \(File too large\); make room"), limit(1000):
        save_filmstrip(path, [FilmstripRow("0.9 Hz", *pose(8))])
    assert {each.name: each.read_bytes() for each in tmp_path.iterdir()} == {"strides.png": b"of before"}


def test_a_filmstrip_without_a_stride_fails(tmp_path: Path):
    """Rather than to be done without a picture."""
    options = PlayOptions(agent="mocap", duration=0.5, device="cpu", filmstrip=tmp_path / "strides.png")
    with pytest.raises(UserError, match=r"no robot did a whole stride; give a longer --duration"):
        play(options, get_task("flat"))
    assert not list(tmp_path.iterdir())


def test_a_training(tmp_path: Path):
    """Its last checkpoint stays, and what it was about to write does not."""
    task = get_task("flat")
    task.learning.hidden_sizes = (256, 256)
    task.learning.steps_per_iteration = 2
    run = tmp_path / "run"
    options = {"num_envs": 4, "device": "cpu", "engine": "mujoco"}
    train(task, RunOptions(**options, max_iterations=1, run_dir=run))
    before = {path.name: path.read_bytes() for path in run.glob("model_*")}
    with pytest.raises(UserError, match=r"cannot write .*model_1.pt \(File too large\); make room"), limit(300_000):
        train(task, RunOptions(**options, max_iterations=2, resume=run))
    assert {path.name: path.read_bytes() for path in run.glob("model_*")} == before
    assert not list(run.glob("*.partial"))
    assert checkpoint.read(run)["iteration"] == 1


def test_a_full_temporary_folder():
    """Named as that; the model goes through it on its way to MuJoCo."""
    sentence = r"cannot write into .* \(File too large\); make room there, or set TMPDIR"
    with pytest.raises(UserError, match=sentence), limit(1000):
        MujocoEngine(1, "cpu", motors(), Physics())


def test_no_temporary_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The same sentence."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
    with pytest.raises(UserError, match=r"cannot write into .* \(No such file or directory\); make room there, or set"):
        MujocoEngine(1, "cpu", motors(), Physics())


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG, errno.EACCES])
def test_disks_are_not_faults_of_the_program(number: int, capsys: pytest.CaptureFixture):
    """Wherever they show: a line, and exit status 2."""

    def command() -> None:
        raise OSError(number, "Words", "/somewhere/file")

    with pytest.raises(SystemExit) as end:
        run_command(command)
    assert end.value.code == 2
    assert (
        capsys.readouterr().err == "error: cannot write or read /somewhere/file (Words); make room or choose another\n"
    )


def test_other_faults_keep_their_traceback():
    """As somebody has to mend them."""

    def command() -> None:
        raise OSError(errno.EINVAL, "Words")

    with pytest.raises(OSError, match="Words"):
        run_command(command)
