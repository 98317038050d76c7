"""Picture of a fitted pattern network: generated angles (paper, Fig. 2b) and the retargeted gaits as stick figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from aicpg_newton.gait.cpg import PatternNetwork, rhythm_window
from aicpg_newton.motion.cycles import GaitCycle, evaluate_series, root_rotation
from aicpg_newton.robot import rotations
from aicpg_newton.robot.humanoid import CONTROL_DT, CONTROL_RATE, HEAD_CENTRE, LINK_NAMES, joint_index
from aicpg_newton.robot.kinematics import forward_kinematics, skeleton

FREQUENCIES = (0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.4)
"""Stride frequencies shown [Hz]."""

_JOINTS = ("right_hip_y", "right_knee", "right_ankle_y", "right_shoulder_y", "right_elbow", "abdomen_z")
_SECONDS = 6.0
_POSES = 8
_SPACING = 0.95  # between stick figures [m]
_HAND = (0.0, 0.0, -0.259)  # middle of the hand in the lower arm's frame [m]
_LEFT, _RIGHT, _TRUNK = "0.7", "0.1", "0.4"


def save_figure(path: Path, network: PatternNetwork, cycles: Sequence[GaitCycle]) -> None:
    """Draw the generated angles beside the clips' cycles, and both gaits as stick figures.

    Args:
        path: PNG file to write.
        network: The fitted network.
        cycles: The walk and the run it was fitted to.
    """
    figure = Figure(figsize=(16, 13), layout="constrained")
    grid = figure.add_gridspec(5, 3, height_ratios=(1.0, 1.0, 1.0, 1.1, 1.1))
    for i, joint in enumerate(_JOINTS):
        _draw_angles(figure.add_subplot(grid[i // 3, i % 3]), joint, network, cycles)
    figure.legend(handles=_legend(cycles), loc="outside upper center", ncols=5, frameon=False)
    for i, joint in enumerate(("right_hip_y", "right_knee", "right_elbow")):
        _draw_seconds(figure.add_subplot(grid[2, i]), joint, network)
    for i, cycle in enumerate(cycles):
        _draw_stick_figures(figure.add_subplot(grid[3 + i, :]), cycle)
    figure.savefig(path, dpi=90, format="png")


def _colour(frequency: float) -> tuple[float, float, float]:
    """Blue for the slowest stride, red for the fastest."""
    share = (frequency - FREQUENCIES[0]) / (FREQUENCIES[-1] - FREQUENCIES[0])
    return (0.1 + 0.8 * share, 0.35, 0.9 - 0.8 * share)


def _legend(cycles: Sequence[GaitCycle]) -> list[Line2D]:
    generated = [Line2D([], [], color=_colour(f), label=f"S at {f:.1f} Hz") for f in FREQUENCIES]
    clips = [
        Line2D([], [], color="k", linestyle=style, label=f"{c.gait.name} {c.gait.source}, {c.gait.frequency:.3f} Hz")
        for c, style in zip(cycles, ("--", ":"), strict=False)
    ]
    return generated + clips


def _draw_angles(axes: Axes, joint: str, network: PatternNetwork, cycles: Sequence[GaitCycle]) -> None:
    """One joint over a stride: generated at all frequencies, and the clips' cycles."""
    phase = torch.linspace(0.0, 2 * math.pi, 361)
    for frequency in FREQUENCIES:
        angles = network(rhythm_window(phase, torch.full_like(phase, frequency)))[:, joint_index(joint)]
        axes.plot(phase / math.pi, torch.rad2deg(angles), color=_colour(frequency), linewidth=1)
    for cycle, style in zip(cycles, ("--", ":"), strict=False):
        angles = torch.rad2deg(cycle.angles[:, joint_index(joint)])
        axes.plot(2 * torch.arange(len(angles)) / len(angles), angles, color="k", linestyle=style, linewidth=1.8)
    axes.set(title=joint, xlabel="phase [π rad]", ylabel="angle [deg]", xlim=(0, 2))


def _draw_seconds(axes: Axes, joint: str, network: PatternNetwork) -> None:
    """One joint over six seconds, as Fig. 2(b): one row for each frequency, shifted upwards."""
    time = torch.arange(round(_SECONDS * CONTROL_RATE)) * CONTROL_DT
    for row, frequency in enumerate(FREQUENCIES[::2]):
        window = rhythm_window(2 * math.pi * frequency * time, torch.full_like(time, frequency))
        angles = torch.rad2deg(network(window)[:, joint_index(joint)])
        axes.plot(time, angles + 120 * row, color=_colour(frequency), linewidth=1)
    axes.set(title=f"{joint}, rows 120° apart", xlabel="time [s]", ylabel="angle [deg]", xlim=(0, _SECONDS))


def _draw_stick_figures(axes: Axes, cycle: GaitCycle) -> None:
    """A strip of poses over one stride, seen from the right, walking to the right; the line is the floor."""
    pick = torch.arange(_POSES) * (len(cycle.angles) // _POSES)
    phase = pick * (2 * math.pi / len(cycle.angles))
    root = evaluate_series(torch.tensor(cycle.gait.root_harmonics), phase)
    root[:, 0] += _SPACING * torch.arange(_POSES)
    draw_stick_figures(axes, root[:, :3], root_rotation(root), cycle.angles[pick])
    gait = cycle.gait
    axes.set(
        title=f"{gait.name}: {gait.source} on the humanoid, {gait.frequency:.3f} Hz, {gait.speed:.2f} m/s;"
        " eight phases of a stride, right side dark",
        ylabel="height [m]",
        xticks=[],
        ylim=(-0.08, 1.75),
    )


def draw_stick_figures(
    axes: Axes, root_position: torch.Tensor, rotation: torch.Tensor, joint_position: torch.Tensor
) -> None:
    """Poses seen from the right, on a line for the floor; right limbs dark, left limbs light.

    Args:
        axes: Where to draw, in metres.
        root_position: World position of the pelvis [m], shape [poses, 3].
        rotation: Pelvis rotation (x, y, z, w), shape [poses, 4].
        joint_position: Joint angles [rad], shape [poses, 28].
    """
    positions, orientations = forward_kinematics(root_position, rotation, joint_position)

    def point(link: str, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> torch.Tensor:
        index = LINK_NAMES.index(link)
        local = torch.tensor(offset).expand(len(positions), 3)
        return positions[:, index] + rotations.rotate(orientations[:, index], local)

    def line(colour: str, width: float, *points: torch.Tensor) -> None:
        path = torch.stack(points)
        axes.plot(path[..., 0], path[..., 2], color=colour, linewidth=width, solid_capstyle="round")

    tree = skeleton()
    for foot, (side, colour) in enumerate((("right", _RIGHT), ("left", _LEFT))[::-1]):
        corners = tree.sole_corners[1 - foot]
        toe, heel = (
            point(f"{side}_foot", (float(x), 0.0, float(corners[0, 2])))
            for x in (corners[:, 0].max(), corners[:, 0].min())
        )
        ankle = point(f"{side}_foot")
        line(colour, 3, point("pelvis"), point(f"{side}_thigh"), point(f"{side}_shin"), ankle, heel, toe, ankle)
        arm = point(f"{side}_upper_arm"), point(f"{side}_lower_arm"), point(f"{side}_lower_arm", _HAND)
        line(colour, 2, point("head"), *arm)
    line(_TRUNK, 3, point("pelvis"), point("torso"), point("head"), point("head", HEAD_CENTRE))
    head = point("head", HEAD_CENTRE)
    axes.plot(head[:, 0], head[:, 2], "o", color=_TRUNK, markersize=10)
    axes.axhline(0.0, color="k", linewidth=0.8)
    axes.set_aspect("equal")
