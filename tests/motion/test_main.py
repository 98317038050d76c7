"""Command line that fits the pattern network."""

import functools
import subprocess
import sys
from pathlib import Path

import pytest

from aicpg_newton.errors import UserError
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.motion import __main__ as command
from aicpg_newton.motion.__main__ import Fit, fit
from aicpg_newton.motion.fit import fit_pattern_network


@pytest.fixture
def settings(subject):
    """A synthetic pair of clips."""
    return Fit(
        skeleton=subject.skeleton,
        walk=subject.motion("walk.amc", subject.stride_frames(0.9, 2.5)),
        run=subject.motion("run.amc", subject.stride_frames(1.35, 1.5)),
        out=subject.folder / "net.pt",
    )


def change(settings, **fields):
    """The same command with other arguments."""
    return Fit(**{**settings.__dict__, **fields})


def test_it_writes_network_and_picture(settings, monkeypatch, capsys):
    """Frequencies are printed in Hz, the network loads with its gaits, a PNG lies beside it."""
    monkeypatch.setattr(command, "fit_pattern_network", functools.partial(fit_pattern_network, steps=50))
    fit(settings)
    printed = capsys.readouterr().out
    assert "walk walk: 0.900 Hz" in printed
    assert "run run: 1.350 Hz" in printed
    assert "fit error" in printed
    assert [gait.name for gait in PatternNetwork.load(settings.out).gaits] == ["walk", "run"]
    assert settings.out.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    assert sorted(path.suffix for path in settings.out.parent.glob("net*")) == [".png", ".pt"]


def sixty(settings, name):
    """A clip's every second frame, as if taken at 60 frames a second."""
    lines, kept, out = getattr(settings, name).read_text().splitlines(), True, []
    for line in lines:
        if line.strip().isdigit():
            kept = int(line) % 2 == 1
            line = str((int(line) + 1) // 2)
        if kept:
            out.append(line)
    path = settings.out.parent / f"{name}_60.amc"
    path.write_text("\n".join(out) + "\n")
    return path


def test_clips_of_sixty_frames_a_second(settings, monkeypatch, capsys):
    """Taken for 120 they are questioned; told apart they give the same strides, both or one of them."""
    monkeypatch.setattr(command, "fit_pattern_network", functools.partial(fit_pattern_network, steps=50))
    slow = change(settings, walk=sixty(settings, "walk"), run=sixty(settings, "run"))
    with pytest.raises(
        UserError, match=r"walk_60 has 1\.80 strides a second .* may have been taken at 60; give --frame-r"
    ):
        fit(slow)
    with pytest.raises(UserError, match=r"run_60 has 2\.70 strides a second"):
        fit(change(slow, walk=settings.walk))
    assert not settings.out.exists()
    for clips in (change(slow, frame_rate=(60.0,)), change(slow, walk=settings.walk, frame_rate=(120.0, 60.0))):
        fit(clips)
        walk, run = PatternNetwork.load(settings.out).gaits
        assert (walk.frequency, run.frequency) == pytest.approx((0.9, 1.35), rel=2e-3)
    fit(settings)
    exact = PatternNetwork.load(settings.out).gaits
    assert (walk.speed, run.speed) == pytest.approx(tuple(gait.speed for gait in exact), rel=0.01)
    for rate in ((0.0,), (60.0, 60.0, 60.0), (float("nan"),)):
        with pytest.raises(UserError, match="--frame-rate is"):
            fit(change(settings, frame_rate=rate))


def test_bad_input_is_one_sentence_and_overwrites_nothing(settings):
    """Every mistake is a UserError before anything is written."""
    settings.out.write_text("precious")
    folder = settings.out.parent
    cases = {
        "there is no file": change(settings, run=folder / "none.amc"),
        "swap --walk and --run": change(settings, walk=settings.run, run=settings.walk),
        "is not below the run's": change(settings, run=settings.walk),
        "there is no folder": change(settings, out=folder / "nowhere" / "net.pt"),
        "must be a file": change(settings, out=folder / "net.png"),
        "would overwrite a clip": change(settings, out=settings.walk),
        "not an Acclaim motion": change(settings, walk=settings.skeleton),
    }
    for message, bad in cases.items():
        with pytest.raises(UserError, match=message):
            fit(bad)
    assert settings.out.read_text() == "precious"
    assert settings.walk.read_text().startswith("# synthetic")


def test_the_command_exits_with_2_and_no_traceback(settings):
    """The process shows one line on stderr."""
    arguments = ["--skeleton", "none.asf", "--walk", "a.amc", "--run", "b.amc", "--out", str(settings.out)]
    done = subprocess.run(
        [sys.executable, "-m", "aicpg_newton.motion", *arguments],
        capture_output=True,
        text=True,
        cwd=Path(__file__).resolve().parents[2],
    )
    assert done.returncode == 2
    assert done.stderr.startswith("error: there is no file none.asf")
    assert "Traceback" not in done.stderr
    assert not settings.out.exists()
