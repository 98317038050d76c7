"""Checkpoint files: whole or not at all, and clear words about bad ones."""

import errno
import os
import struct
import zipfile
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
    monkeypatch.setattr(checkpoint, "fingerprint", lambda: "0123456789ab")
    with pytest.raises(UserError, match="trained on humanoid"):
        checkpoint.read(tmp_path / "model_1.pt")


class Command:
    """Runs a command when it is unpickled, if the reader lets it."""

    def __init__(self, command: str) -> None:
        self.command = command

    def __reduce__(self) -> tuple:
        return os.system, (self.command,)


def hostile(kind: str, folder: Path) -> Path:
    """A checkpoint by somebody who means harm."""
    path = folder / "model_1.pt"
    write(path)
    content = torch.load(path, weights_only=True)
    mark = folder / "mark"
    if kind in ("pickle", "legacy"):
        content["run"]["seed"] = Command(f"touch {mark}")
        torch.save(content, path, _use_new_zipfile_serialization=kind == "pickle")
    elif kind == "huge tensor":
        content["algorithm"]["actor_state_dict"]["weight"] = torch.zeros(1).expand(10**12)
        torch.save(content, path)
    elif kind == "sparse":
        content["algorithm"]["actor_state_dict"]["weight"] = torch.sparse_coo_tensor(
            torch.tensor([[0]]), torch.tensor([1.0]), (10**12,)
        )
        torch.save(content, path)
    elif kind == "laughs":
        laughs: list = ["ha"]
        for _ in range(30):
            laughs = [laughs] * 10
        content["run"]["seed"] = laughs
        torch.save(content, path)
    elif kind == "deep":
        nested: list = []
        for _ in range(300):
            nested = [nested]
        content["run"]["seed"] = nested
        torch.save(content, path)
    elif kind in ("bomb", "claim"):
        with zipfile.ZipFile(path) as archive:
            parts = {entry.filename: archive.read(entry) for entry in archive.infolist()}
        packing = zipfile.ZIP_DEFLATED if kind == "bomb" else zipfile.ZIP_STORED
        with zipfile.ZipFile(path, "w", packing) as archive:
            for name, data in parts.items():
                large = name.endswith("data/0")
                archive.writestr(name, bytes(50_000_000) if large and kind == "bomb" else data)
        if kind == "claim":  # a storage says that it is larger than it is
            data = path.read_bytes()
            assert data.count(struct.pack("<BH", ord("M"), 5000)) >= 1
            path.write_bytes(data.replace(struct.pack("<BH", ord("M"), 5000), struct.pack("<BH", ord("M"), 60000)))
    return path


@pytest.mark.parametrize("kind", ["pickle", "legacy", "huge tensor", "sparse", "laughs", "deep", "bomb", "claim"])
def test_hostile_files_do_nothing_and_cost_nothing(kind: str, tmp_path: Path):
    """Refused in a sentence: no code runs, and no memory is taken that the file does not have."""
    path = hostile(kind, tmp_path)
    with pytest.raises(UserError, match=r"cannot be read as a checkpoint"):
        checkpoint.read(path)
    assert not (tmp_path / "mark").exists()


def test_the_hostile_pickle_would_have_run(tmp_path: Path):
    """Otherwise the test above could not fail."""
    path = hostile("pickle", tmp_path)
    torch.load(path, weights_only=False)
    assert (tmp_path / "mark").exists()


@pytest.mark.parametrize(
    ("key", "value"), [("iteration", "3"), ("iteration", True), ("samples", -1), ("run", []), ("humanoid", 3)]
)
def test_content_of_the_wrong_kind_is_refused(key: str, value: object, tmp_path: Path):
    """Before anything is done with it."""
    write(tmp_path / "model_1.pt")
    content = checkpoint.read(tmp_path / "model_1.pt")
    checkpoint.save({**content, key: value}, tmp_path / "model_1.pt")
    with pytest.raises(UserError, match="it is broken, fetch it again"):
        checkpoint.read(tmp_path / "model_1.pt")


def test_checkpoints_are_read_in_one_place():
    """Which is the one that is careful."""
    root = Path(checkpoint.__file__).parents[1]
    callers = [path.name for path in root.rglob("*.py") if "torch.load(" in path.read_text(encoding="utf-8")]
    assert callers == ["tensor_files.py"]
    assert (root / "tensor_files.py").read_text(encoding="utf-8").count("weights_only=True") == 1


def test_checkpoints_from_before_facts_were_taken_are_of_this_humanoid(tmp_path: Path):
    """They hold a fingerprint of the file's bytes; those of any other file are refused."""
    write(tmp_path / "model_1.pt")
    content = checkpoint.read(tmp_path / "model_1.pt")
    checkpoint.save({**content, "humanoid": "60eacc976df0"}, tmp_path / "model_1.pt")
    assert checkpoint.read(tmp_path / "model_1.pt")["humanoid"] == content["humanoid"]
    checkpoint.save({**content, "humanoid": "60eacc976df1"}, tmp_path / "model_1.pt")
    with pytest.raises(UserError, match="trained on humanoid 60eacc976df1"):
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
