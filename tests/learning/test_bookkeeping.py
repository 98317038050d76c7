"""Folders belong to one run, and what a run notes about its code never stops it."""

import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from aicpg_newton.errors import UserError
from aicpg_newton.learning import bookkeeping
from aicpg_newton.learning.bookkeeping import claim, git_revision, new_folder, release, store_changes


def test_runs_of_the_same_second_get_folders_of_their_own(tmp_path: Path):
    """Twenty at once."""
    with ThreadPoolExecutor(20) as pool:
        folders = list(pool.map(lambda _: new_folder(tmp_path / "ai-cpg"), range(20)))
    assert len(set(folders)) == 20
    assert all((folder / ".claimed").is_file() for folder in folders)


def test_a_folder_is_given_once(tmp_path: Path):
    """An empty one too; released without a run it is gone, with one it stays."""
    folder = tmp_path / "run"
    folder.mkdir()
    claim(folder)
    with pytest.raises(UserError, match="has just been taken by another run"):
        claim(folder)
    release(folder)
    assert not folder.exists()
    claim(folder)
    (folder / "config.yaml").write_text("x")
    release(folder)
    assert [path.name for path in folder.iterdir()] == ["config.yaml"]
    with pytest.raises(UserError, match="is not empty"):
        claim(folder)
    assert [path.name for path in folder.iterdir()] == ["config.yaml"]
    with pytest.raises(UserError, match="cannot write into"):
        claim(folder / "config.yaml" / "below")


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A checkout with one commit that stands for this one."""
    folder = tmp_path / "checkout"
    folder.mkdir()

    def git(*arguments: str) -> None:
        subprocess.run(["git", "-c", "user.name=a", "-c", "user.email=a@b", *arguments], cwd=folder, check=True)

    git("init", "-q")
    (folder / "code.py").write_text("one = 1\n")
    git("add", "code.py")
    git("commit", "-qm", "first")
    monkeypatch.setattr(bookkeeping, "_HERE", folder)
    return folder


def test_revision_and_changes(repository: Path, tmp_path: Path):
    """A change in any encoding is marked and kept byte for byte; none leaves no file."""
    revision, reason = git_revision()
    assert len(revision) == 40 and reason == ""
    out = tmp_path / "out"
    out.mkdir()
    store_changes(out)
    assert not list(out.iterdir())
    (repository / "code.py").write_bytes(b"one = 1  # \xfc\n")
    assert git_revision()[0] == revision + "+"
    store_changes(out)
    assert b"+one = 1  # \xfc" in (out / "git" / "changes.diff").read_bytes()
    store_changes(tmp_path / "nowhere")  # is told, and no more


@pytest.mark.parametrize("cause", ["no git", "no repository", "not the owner"])
def test_without_git_the_reason_is_told(cause: str, repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """No git, no checkout, or one that git does not trust."""
    if cause == "no git":
        monkeypatch.setenv("PATH", str(tmp_path))
        expected = "git is not installed"
    elif cause == "no repository":
        monkeypatch.setattr(bookkeeping, "_HERE", tmp_path)
        expected = "not a git repository"
    else:
        monkeypatch.setenv("GIT_TEST_ASSUME_DIFFERENT_OWNER", "1")
        expected = "dubious ownership"
    revision, reason = git_revision()
    assert revision == "unknown" and expected in reason and "\n" not in reason
    store_changes(tmp_path)
    assert not (tmp_path / "git").exists()
