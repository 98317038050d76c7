"""Commands whose output pipe or terminal is closed: they continue, and say so on stderr."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

WORK = """
import sys
from pathlib import Path

from aicpg_newton.errors import run_command


def work():
    for line in range(10_000):
        print("iteration", line)
        if line % 1000 == 0:
            print("progress", line, file=sys.stderr)
    Path(sys.argv[1]).write_text("saved")


run_command(work)
"""


def run(arguments: list[str], closed: str) -> tuple[int, str]:
    """Run the work above with a pipe whose reader has gone: exit status, and what the other stream says."""
    read, write = os.pipe()
    os.close(read)
    other = "stderr" if closed == "stdout" else "stdout"
    streams = {closed: write, other: subprocess.PIPE}
    command = [sys.executable, "-c", WORK, *arguments]
    root = Path(__file__).resolve().parent.parent
    result = subprocess.run(
        command, cwd=root, text=True, check=False, stdout=streams["stdout"], stderr=streams["stderr"]
    )
    os.close(write)
    return result.returncode, getattr(result, other)


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_the_reader_of_stdout_goes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, unbuffered: str):
    """The work is done to its end, and one line says why nothing more is shown."""
    monkeypatch.setenv("PYTHONUNBUFFERED", unbuffered)
    status, said = run([str(tmp_path / "file")], "stdout")
    assert status == 0 and (tmp_path / "file").read_text() == "saved"
    assert said.count("The reader of the output has ended; continuing without console output.\n") == 1
    assert "progress 9000\n" in said and "Traceback" not in said


def test_the_reader_of_stderr_goes(tmp_path: Path):
    """Progress bars and warnings are no reason to stop either."""
    status, said = run([str(tmp_path / "file")], "stderr")
    assert status == 0 and (tmp_path / "file").read_text() == "saved"
    assert said.endswith("iteration 9999\n") and "reader of the output" not in said


def test_help_is_not_read_to_its_end(tmp_path: Path):
    """It ends without a word, as other programs do."""
    status, said = run([str(tmp_path / "file"), "--help"], "stdout")
    assert status == 1 and "reader of the output" not in said and "Traceback" not in said
    assert not (tmp_path / "file").exists()
