"""Checkpoint files: whole or not at all, and clear words about bad ones."""

import errno
from pathlib import Path
from typing import IO

import pytest
import torch

from aicpg_newton.errors import UserError
from aicpg_newton.learning import checkpoint


def write(path: Path, iteration: int = 3) -> None:
    """A small checkpoint."""
    checkpoint.write(
        path,
        task={"name": "flat"},
        pattern={"format": 1},
        observations=[["height", 1]],
        run={"seed": 0},
        iteration=iteration,
        samples=100,
        algorithm={"actor_state_dict": {"weight": torch.arange(5000.0)}},
    )


def test_round_trip(tmp_path: Path):
    """What is written is read, and no partial file is left."""
    write(tmp_path / "model_3.pt")
    content = checkpoint.read(tmp_path / "model_3.pt")
    assert content["iteration"] == 3
    assert torch.equal(content["algorithm"]["actor_state_dict"]["weight"], torch.arange(5000.0))
    assert [path.name for path in tmp_path.iterdir()] == ["model_3.pt"]


def test_checkpoints_of_the_first_version_do_not_say_what_they_see(tmp_path: Path):
    """They are read as they are."""
    write(tmp_path / "model_3.pt")
    content = checkpoint.read(tmp_path / "model_3.pt")
    del content["observations"]
    checkpoint.save(content, tmp_path / "old.pt")
    assert "observations" not in checkpoint.read(tmp_path / "old.pt")


def test_a_run_folder_means_its_latest_checkpoint(tmp_path: Path):
    """By number, not by name or time."""
    for iteration in (100, 20, 3):
        write(tmp_path / f"model_{iteration}.pt", iteration)
    (tmp_path / "model_best.pt").write_bytes(b"")
    assert checkpoint.read(tmp_path)["iteration"] == 100


def test_missing_torn_and_foreign_files(tmp_path: Path):
    """Each gets a sentence of its own."""
    with pytest.raises(UserError, match="no checkpoint at"):
        checkpoint.read(tmp_path / "model_1.pt")
    with pytest.raises(UserError, match="holds a checkpoint"):
        checkpoint.read(tmp_path)
    write(tmp_path / "model_1.pt")
    torn = tmp_path / "torn.pt"
    torn.write_bytes((tmp_path / "model_1.pt").read_bytes()[:-3000])
    with pytest.raises(UserError, match="cut short"):
        checkpoint.read(torn)
    torn.write_bytes(b"")
    with pytest.raises(UserError, match="cut short"):
        checkpoint.read(torn)
    torch.save({"weights": torch.zeros(3)}, torn)
    with pytest.raises(UserError, match="not a checkpoint of this version"):
        checkpoint.read(torn)


def test_another_humanoid_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A network trained on another robot is not played on this one."""
    write(tmp_path / "model_1.pt")
    monkeypatch.setattr(checkpoint.humanoid, "version", lambda: "0123456789ab")
    with pytest.raises(UserError, match="trained on humanoid"):
        checkpoint.read(tmp_path / "model_1.pt")


def test_a_failed_write_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """When the disk is full in the middle of a save, the checkpoint before it survives."""
    write(tmp_path / "model_1.pt", 1)

    def fail(content: object, file: IO[bytes]) -> None:
        file.write(b"half")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(torch, "save", fail)
    with pytest.raises(UserError, match=r"cannot write .*model_1\.pt \(No space left on device\)"):
        write(tmp_path / "model_1.pt", 2)
    assert [path.name for path in tmp_path.iterdir()] == ["model_1.pt"]
    assert checkpoint.read(tmp_path / "model_1.pt")["iteration"] == 1
