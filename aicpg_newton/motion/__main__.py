"""Fit the pattern network S from two motion capture clips: ``python -m aicpg_newton.motion --help``."""

from __future__ import annotations

import os
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from aicpg_newton.errors import UserError, run_command
from aicpg_newton.files import WholeFile
from aicpg_newton.gait.cpg import Gait
from aicpg_newton.motion.acclaim import FRAME_RATE, check_clip, read_motion, read_skeleton
from aicpg_newton.motion.cycles import gait_cycle
from aicpg_newton.motion.figure import save_figure
from aicpg_newton.motion.fit import fit_pattern_network
from aicpg_newton.motion.retarget import flat_soles, retarget
from aicpg_newton.ranges import Range, check_ranges


@dataclass(frozen=True)
class Fit:
    """Fit the pattern network to a walk and a run of one subject, and draw what it generates."""

    skeleton: Path
    """Acclaim skeleton of the subject (.asf)."""
    walk: Path
    """Motion of a straight walk (.amc)."""
    run: Path
    """Motion of a straight run (.amc)."""
    out: Path
    """Network file to write; the picture goes beside it with the suffix .png."""
    frame_rate: Annotated[tuple[float, ...], Range(1.0, 1000.0)] = ()
    """Frames per second of both clips, or of the walk and of the run; 120 when not given, as most of CMU's have."""


def fit(settings: Fit) -> None:
    """Read the clips, fit, print what was found, write network and picture.

    Raises:
        UserError: A file is missing or broken, the clips do not fit together, or ``out`` cannot be written.
    """
    check_ranges(settings, "--")
    picture = settings.out.with_suffix(".png")
    _check_output(settings, picture)
    skeleton = read_skeleton(settings.skeleton)
    rates = _frame_rates(settings)
    paths = {"walk": settings.walk, "run": settings.run}
    motions = {name: read_motion(path, skeleton, rates[name]) for name, path in paths.items()}
    for motion in motions.values():
        check_clip(motion)
    soles = flat_soles(skeleton, motions["walk"])
    cycles = [gait_cycle(retarget(skeleton, motion, soles), name) for name, motion in motions.items()]
    walk, run = (cycle.gait for cycle in cycles)
    if walk.frequency >= run.frequency:
        raise UserError(
            f"the walk's stride frequency ({walk.frequency:.3f} Hz) is not below the run's ({run.frequency:.3f} Hz);"
            " swap --walk and --run or give other clips"
        )
    for gait in (walk, run):
        print(f"{gait.name} {gait.source}: {gait.frequency:.3f} Hz, {gait.speed:.2f} m/s on the humanoid", flush=True)
    if not settings.frame_rate:
        for gait in (walk, run):
            _question(gait)
    network = fit_pattern_network(cycles)
    for gait in network.gaits:
        print(f"{gait.name} fit error: {gait.fit_error:.4f} rad RMS, worst joint {gait.worst_fit_error:.4f} rad")
    with WholeFile(settings.out) as network_file, WholeFile(picture) as picture_file:
        network.save(network_file)
        save_figure(picture_file, network, cycles)
    print(f"wrote {settings.out} and {picture}")


_STRIDES = {"walk": (0.6, 1.3), "run": (1.1, 2.0)}
"""Stride frequencies of people that walk and run [Hz], from a stroll to a race."""


def _frame_rates(settings: Fit) -> dict[str, float]:
    """Frames per second of each clip [Hz]."""
    given = settings.frame_rate
    if len(given) > 2:
        raise UserError(
            f"--frame-rate is {given}; give one number for both clips, or one for the walk and one for the run"
        )
    return {"walk": given[0], "run": given[-1]} if given else {"walk": FRAME_RATE, "run": FRAME_RATE}


def _question(gait: Gait) -> None:
    """Refuse a clip that nobody moves like, as long as its frame rate is only assumed."""
    low, high = _STRIDES[gait.name]
    if not low <= gait.frequency <= high:
        rate = FRAME_RATE / 2 if gait.frequency > high else FRAME_RATE * 2
        raise UserError(
            f"{gait.source} has {gait.frequency:.2f} strides a second at {FRAME_RATE:g} frames a second, but people"
            f" {gait.name} with {low} to {high}: it may have been taken at {rate:g}; give --frame-rate, for the walk"
            " and for the run where they differ"
        )


def _check_output(settings: Fit, picture: Path) -> None:
    """Refuse an output that cannot be written or would overwrite an input."""
    out = settings.out
    if not out.parent.is_dir() or not os.access(out.parent, os.W_OK):
        raise UserError(f"--out {out}: there is no folder {out.parent} that can be written to; make it first")
    if out.is_dir() or out.suffix == ".png":
        raise UserError(
            f"--out {out} must be a file for the network, as pattern_network.pt; the picture is written beside"
        )
    inputs = {os.path.realpath(path) for path in (settings.skeleton, settings.walk, settings.run)}
    if inputs & {os.path.realpath(out), os.path.realpath(picture)}:
        raise UserError(f"--out {out} would overwrite a clip; give another name")


def _show_warning(message: Warning | str, *_: object) -> None:
    print(f"warning: {message}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    warnings.showwarning = _show_warning  # type: ignore[assignment]
    run_command(lambda: fit(tyro.cli(Fit)))
