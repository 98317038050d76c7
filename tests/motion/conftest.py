"""A synthetic subject with CMU's bone names, and the folder of real clips."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FRAME_RATE = 120.0


class Subject:
    """Writes an ASF and AMCs: legs splayed by 20 degrees and arms out in the rest pose, every value 0 unless given."""

    thigh, shin = 7.0, 8.0  # in units of 1 / 0.45 inch

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.bones: dict[str, tuple[str, tuple[float, float, float], float, str, str]] = {
            "thorax": ("root", (0, 1, 0), 6.0, "0 0 0", "rx ry rz"),
            "head": ("thorax", (0, 1, 0), 5.0, "0 0 0", "rx ry rz"),
        }
        for side, sign in (("l", 1.0), ("r", -1.0)):
            leg = (sign * math.sin(math.radians(20)), -math.cos(math.radians(20)), 0.0)
            splay, arm = f"0 0 {20 * sign:g}", f"180 {-30 * sign:g} {-90 * sign:g}"
            self.bones |= {
                f"{side}hipjoint": ("root", (sign, 0, 0), 2.0, "0 0 0", ""),
                f"{side}femur": (f"{side}hipjoint", leg, self.thigh, splay, "rx ry rz"),
                f"{side}tibia": (f"{side}femur", leg, self.shin, splay, "rx"),
                f"{side}foot": (f"{side}tibia", (0, 0, 1), 2.0, f"-90 0 {20 * sign:g}", "rx rz"),
                f"{side}toes": (f"{side}foot", (0, 0, 1), 1.0, f"-90 0 {20 * sign:g}", "rx"),
                f"{side}clavicle": ("thorax", (sign, 0, 0), 3.0, "0 0 0", "ry rz"),
                f"{side}humerus": (f"{side}clavicle", (sign, 0, 0), 5.0, arm, "rx ry rz"),
                f"{side}radius": (f"{side}humerus", (sign, 0, 0), 4.0, arm, "rx"),
            }
        self.skeleton = folder / "subject.asf"
        self.skeleton.write_text(self.skeleton_text())

    def skeleton_text(self) -> str:
        """The ASF."""
        lines = [
            ":units",
            "  length 0.45",
            "  angle deg",
            ":root",
            "   order TX TY TZ RX RY RZ",
            "   axis XYZ",
            ":bonedata",
        ]
        for name, (_, direction, length, axis, dof) in self.bones.items():
            lines += ["  begin", f"    name {name}", "    direction {:.9f} {:.9f} {:.9f}".format(*direction)]
            lines += [f"    length {length}", f"    axis {axis} XYZ"]
            lines += [f"    dof {dof}", "    limits (-160.0 20.0)", "           (-70.0 70.0)"] if dof else []
            lines += ["  end"]
        children = [f"    {parent} {name}" for name, (parent, *_) in self.bones.items()]
        return "\n".join([*lines, ":hierarchy", "  begin", *children, "  end", ""])

    def motion_text(self, frames: list[dict[str, tuple[float, ...]]]) -> str:
        """An AMC; legs hang down unless a frame says otherwise."""
        lines = ["# synthetic", ":FULLY-SPECIFIED", ":DEGREES"]
        standing = {"lfemur": (0.0, 0.0, -20.0), "rfemur": (0.0, 0.0, 20.0)}
        for number, given in enumerate(frames, start=1):
            lines.append(str(number))
            counts = {"root": 6} | {name: len(bone[-1].split()) for name, bone in self.bones.items() if bone[-1]}
            for name, count in counts.items():
                values = given.get(name, standing.get(name, (0.0,) * count))
                lines.append(name + "".join(f" {value:.6f}" for value in values))
        return "\n".join([*lines, ""])

    def motion(self, name: str, frames: list[dict[str, tuple[float, ...]]]) -> Path:
        """Write an AMC."""
        path = self.folder / name
        path.write_text(self.motion_text(frames))
        return path

    def stride_frames(
        self,
        frequency: float,
        seconds: float,
        *,
        swing: float = 25.0,
        speed: float | None = None,
        scale: float = 1.0,
        rise: float = 0.0,
    ) -> list[dict[str, tuple[float, ...]]]:
        """A gait: hips swing about 10 degrees of flexion, knees bend in swing, the root moves ahead (ASF lengths).

        The root goes as the foot that is left behind stands still, ``scale`` times as far, or at a ``speed``.
        """
        frames = []
        place, before = 0.0, None
        for index in range(round(seconds * FRAME_RATE)):
            time = index / FRAME_RATE
            frame: dict[str, tuple[float, ...]] = {}
            balls = []
            for side, shift in (("r", 0.0), ("l", math.pi)):
                phase = 2 * math.pi * frequency * time + shift
                hip = -10.0 - swing * math.sin(phase) - 0.1 * swing * math.cos(2 * phase)
                knee = 20.0 + swing * 0.7 * (1.0 + math.cos(phase))
                frame[f"{side}femur"] = (hip, 0.0, 20.0 if side == "r" else -20.0)
                frame[f"{side}tibia"] = (knee,)
                thigh, shin = math.radians(hip), math.radians(hip + knee)
                balls.append(2.0 * math.cos(shin) - self.thigh * math.sin(thigh) - self.shin * math.sin(shin))
            if before is not None:
                place += scale * max(then - now for then, now in zip(before, balls, strict=True))
            before = balls
            ahead = place if speed is None else speed * time
            frames.append(frame | {"root": (0.0, 17.0 + rise * time, ahead, 0.0, 0.0, 0.0)})
        return frames


@pytest.fixture
def subject(tmp_path: Path) -> Subject:
    """A synthetic subject whose files lie in a temporary folder."""
    return Subject(tmp_path)


@pytest.fixture
def mocap() -> Path:
    """The folder of CMU clips beside the repository."""
    folder = ROOT.parent / "shared" / "mocap"
    if not folder.is_dir():
        pytest.skip("the CMU clips (shared/mocap beside the repository) are not here")
    return folder
