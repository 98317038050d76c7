"""The script that draws variants of a controller side by side."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def call(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run it."""
    command = [sys.executable, "scripts/compare_sweeps.py", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def test_the_figure_of_the_docs(tmp_path: Path):
    """From the tables in the repository."""
    picture = tmp_path / "eq7.png"
    result = call("--sweeps", "docs/eq7/ours", "docs/eq7/printed", "--out", str(picture))
    assert result.returncode == 0, result.stderr
    assert picture.read_bytes().startswith(b"\x89PNG") and picture.stat().st_size > 20_000


def test_bad_input(tmp_path: Path):
    """One sentence, no picture."""
    picture = tmp_path / "picture.png"
    for folders, said in (
        (["docs"], "there is no docs/sweep.csv"),
        (["docs/eq7/ours", "./docs/eq7/ours"], "have the same name"),
        (["assets/policies/baselines_evaluation"], "holds no sweep over stride frequencies"),
    ):
        result = call("--sweeps", *folders, "--out", str(picture))
        assert result.returncode == 2 and said in result.stderr and "Traceback" not in result.stderr
    assert (
        "--names are 1, folders 2"
        in call("--sweeps", "docs/eq7/ours", "docs/eq7/printed", "--names", "ours", "--out", str(picture)).stderr
    )
    assert "ends in .png" in call("--sweeps", "docs/eq7/ours", "--out", str(tmp_path / "picture")).stderr
    assert list(tmp_path.iterdir()) == []
