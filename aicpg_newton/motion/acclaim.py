"""Reader of Acclaim skeletons (ASF) and motions (AMC), as the CMU motion capture database publishes them.

Acclaim frame: x left, y up, z forward. A bone's global rotation is measured from the skeleton's rest pose (arms out to
the sides, legs apart), in which every rotation is the identity.
"""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from aicpg_newton.errors import UserError
from aicpg_newton.texts import number, read_text

FRAME_RATE = 120.0
"""Frames per second of a :class:`Motion` [Hz], and of most CMU clips; AMC files do not say, and some have 60."""

INCH = 0.0254
"""Lengths in an ASF are inches once divided by its length unit [m]."""

_LARGEST = 1e6
"""No position [inches] and no angle [deg] is as large."""

ROOT = "root"
_COMMENT = re.compile(r"(?<!\S)#.*")
_ROOT_ORDER = ["tx", "ty", "tz", "rx", "ry", "rz"]


@dataclass(frozen=True)
class Bone:
    """One bone; it starts where its parent ends."""

    name: str
    direction: torch.Tensor
    """Unit vector from start to end in the rest pose, Acclaim frame, shape [3]."""
    length: float
    """Length [m]."""
    axis: torch.Tensor
    """Rotation C from the frame of the bone's own degrees of freedom to the Acclaim frame, shape [3, 3]."""
    dof: tuple[str, ...]
    """Its degrees of freedom, of ``rx``, ``ry``, ``rz``."""


@dataclass(frozen=True)
class Skeleton:
    """The bones and their tree."""

    source: str
    length_unit: float
    """Length of one unit of the root's position in an AMC [m]."""
    bones: dict[str, Bone]
    """Parents before children; the root is not among them."""
    parents: dict[str, str]
    """Parent of every bone; ``root`` for the first."""

    def channels(self) -> dict[str, int]:
        """Number of values an AMC frame must give for the root and for every bone that moves."""
        return {ROOT: 6} | {bone.name: len(bone.dof) for bone in self.bones.values() if bone.dof}


@dataclass(frozen=True)
class Motion:
    """Values of an AMC."""

    source: str
    values: dict[str, torch.Tensor]
    """Per bone the angles [deg], shape [frames, degrees of freedom]; ``root`` has position [ASF length] first."""


@dataclass(frozen=True)
class Pose:
    """Global bone rotations and positions over time, Acclaim frame."""

    rotations: dict[str, torch.Tensor]
    """Rotation from the rest pose, shape [frames, 3, 3]; with ``root``."""
    ends: dict[str, torch.Tensor]
    """Position of each bone's end [m], shape [frames, 3]; ``root`` is the root's position."""


def euler_matrix(angles: torch.Tensor) -> torch.Tensor:
    """Rotation Rz Ry Rx of Acclaim's axis order XYZ (x is applied first).

    Args:
        angles: Angles about x, y, z [deg], shape [..., 3].

    Returns:
        Rotation matrices, shape [..., 3, 3].
    """
    matrix = torch.eye(3, dtype=angles.dtype).expand(*angles.shape[:-1], 3, 3)
    for axis in range(3):
        cosine, sine = torch.cos(torch.deg2rad(angles[..., axis])), torch.sin(torch.deg2rad(angles[..., axis]))
        turn = torch.zeros_like(matrix)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn[..., axis, axis] = 1.0
        turn[..., i, i] = turn[..., j, j] = cosine
        turn[..., j, i], turn[..., i, j] = sine, -sine
        matrix = turn @ matrix
    return matrix


def pose(skeleton: Skeleton, motion: Motion) -> Pose:
    """Forward kinematics: a bone with axis C and angles M turns by C M C^-1 within its parent.

    Args:
        skeleton: The subject's bones.
        motion: A motion read with this skeleton.

    Returns:
        Global rotations and bone ends for all frames.
    """
    root = motion.values[ROOT]
    rotations = {ROOT: euler_matrix(root[:, 3:])}
    ends = {ROOT: root[:, :3] * skeleton.length_unit}
    for bone in skeleton.bones.values():
        parent = skeleton.parents[bone.name]
        rotation = rotations[parent]
        if bone.dof:
            angles = rotation.new_zeros(len(rotation), 3)
            angles[:, ["xyz".index(name[1]) for name in bone.dof]] = motion.values[bone.name]
            rotation = rotation @ bone.axis @ euler_matrix(angles) @ bone.axis.T
        rotations[bone.name] = rotation
        ends[bone.name] = ends[parent] + rotation @ (bone.direction * bone.length)
    return Pose(rotations, ends)


def _lines(path: Path) -> list[tuple[int, list[str]]]:
    """Numbered lines of a text file split into words, without comments and empty lines; LF or CRLF.

    A comment begins with a word that begins with ``#``: within a word it is part of it, as in the ``-1.#IND00`` that C
    libraries of Windows print for what is not a number.
    """
    if not path.is_file():
        raise UserError(f"there is no file {path}; give the path of an existing Acclaim file")
    lines = enumerate(re.split("\r\n|\n|\r", read_text(path)), start=1)
    return [(place, words) for place, line in lines if (words := _COMMENT.sub("", line).split())]


def _numbers(words: list[str]) -> list[float]:
    """Numbers of a size that lengths, positions and angles have.

    Raises:
        ValueError: A word is no number, or beyond all that a subject can do.
    """
    values = [number(word) for word in words]
    if any(abs(value) > _LARGEST for value in values):
        raise ValueError(f"{' '.join(words)[:60]} is not of this world")
    return values


def read_skeleton(path: Path) -> Skeleton:
    """Read an ASF file.

    Args:
        path: The file; angles in degrees, axis order XYZ, as CMU writes them.

    Raises:
        UserError: The file is missing, broken, or in a convention other than CMU's; the message says where.
    """
    section, length, bones, parents = "", math.nan, {}, {}
    fields: dict[str, list[str]] = {}
    lines = _lines(path)
    place, words = 0, [""]
    try:
        for place, words in lines:  # noqa: B007, read in the message below
            key, rest = words[0].lower(), words[1:]
            if key.startswith(":"):
                section = key
            elif section == ":units" and key == "length":
                (length,) = _numbers(rest)
                if length <= 0.0:
                    raise ValueError("the unit of length must be positive")
            elif section == ":units" and key == "angle" and not rest[0].lower().startswith("deg"):
                raise ValueError("angles must be in degrees")
            elif section == ":root" and key == "order" and [word.lower() for word in rest] != _ROOT_ORDER:
                raise ValueError("the root's order must be TX TY TZ RX RY RZ")
            elif section in (":root", ":bonedata") and key == "axis" and rest[-1].upper() != "XYZ":
                raise ValueError("the axis order must be XYZ")
            elif section == ":bonedata" and key == "begin":
                fields = {"dof": []}
            elif section == ":bonedata" and key == "end":
                bone = _bone(fields, INCH / length)
                if bone.name in bones or bone.name == ROOT:
                    raise ValueError(f"bone {bone.name} stands twice")
                bones[bone.name] = bone
            elif section == ":bonedata":
                fields[key] = rest
            elif section == ":hierarchy" and key not in ("begin", "end"):
                if words[0] != ROOT and words[0] not in parents:
                    raise ValueError(f"bone {words[0]} has children before it has a parent")
                if len({*rest} - {*parents}) < len(rest):
                    raise ValueError("a bone has two parents")
                parents.update({child: words[0] for child in rest})
    except (ValueError, IndexError, KeyError, ZeroDivisionError) as error:
        raise UserError(f"{path} line {place} ({' '.join(words)[:40]}) is not as in a CMU skeleton: {error}") from error
    missing = set(bones) ^ set(parents)
    if not bones or missing:
        what = f"bone {min(missing)} stands in only one of :bonedata and :hierarchy" if missing else "it has no bones"
        raise UserError(f"{path} is not a whole Acclaim skeleton: {what}; fetch it again")
    return Skeleton(path.name, INCH / length, {name: bones[name] for name in parents}, parents)


def _bone(fields: dict[str, list[str]], unit: float) -> Bone:
    """A bone from the words of its fields and the length unit [m]."""
    dof = tuple(word.lower() for word in fields["dof"])
    if not set(dof) <= {"rx", "ry", "rz"} or len(set(dof)) < len(dof):
        raise ValueError(f"bone {fields['name'][0]} has degrees of freedom other than one each of rx, ry and rz")
    direction, axis = (torch.tensor(_numbers(fields[key][:3]), dtype=torch.float64) for key in ("direction", "axis"))
    if len(direction) != 3 or len(axis) != 3 or direction.norm() == 0:
        raise ValueError(f"bone {fields['name'][0]} needs three numbers for direction and axis")
    (length,) = _numbers(fields["length"])
    if not (length > 0.0 and math.isfinite(length * unit)):
        raise ValueError(f"bone {fields['name'][0]} has a length of {length:g}; lengths are positive")
    return Bone(fields["name"][0], direction / direction.norm(), length * unit, euler_matrix(axis), dof)


def read_motion(path: Path, skeleton: Skeleton, frame_rate: float = FRAME_RATE) -> Motion:
    """Read an AMC file; a last frame that is cut short is left out with a warning.

    Args:
        path: The file, fully specified and in degrees, as CMU writes them.
        skeleton: The subject's skeleton; the motion must name its bones.
        frame_rate: Frames per second of the file [Hz]; another than :data:`FRAME_RATE` is interpolated to that.

    Raises:
        UserError: The file is missing or broken (the message gives the line), or does not belong to the skeleton.
    """
    lines = _lines(path)
    if any(words[0].lower() == ":radians" for _, words in lines):
        raise UserError(f"{path} is in radians, as its header says; give it in degrees, as CMU does")
    lines = [(place, words) for place, words in lines if not words[0].startswith(":")]
    starts = [i for i, (_, words) in enumerate(lines) if len(words) == 1 and re.fullmatch("[0-9]{1,9}", words[0])]
    if not starts or starts[0] != 0:
        raise UserError(f"{path} is not an Acclaim motion: it does not begin with frame 1; give an AMC file")
    frames: list[dict[str, list[float]]] = []
    for start, stop in zip(starts, [*starts[1:], len(lines)], strict=True):
        place, words = lines[start]
        try:
            if int(words[0]) != int(lines[0][1][0]) + len(frames):
                raise UserError(f"{path} line {place}: frame {words[0]} follows frame {len(frames)}; fetch it again")
            frames.append(_frame(path, place, lines[start + 1 : stop], skeleton))
        except UserError:
            if stop < len(lines) or not frames or not _cut_short(lines[start + 1 : stop], skeleton):
                raise
            warnings.warn(f"{path.name}: the last frame ({words[0]}) is cut short and left out", stacklevel=2)
    values = {name: torch.tensor([frame[name] for frame in frames], dtype=torch.float64) for name in frames[0]}
    if frame_rate != FRAME_RATE:
        values = {name: _resampled(each, frame_rate, root=name == ROOT) for name, each in values.items()}
    return Motion(path.name, values)


def check_clip(motion: Motion) -> None:
    """Refuse what is read as a motion but is none of a person: a single frame, or angles in radians.

    Raises:
        UserError: It is.
    """
    angles = [values for name, values in motion.values.items() if name != ROOT]
    if len(angles[0]) < 2:
        raise UserError(f"{motion.source} has {len(angles[0])} whole frames, which is no motion; give a whole stride")
    largest = max(float(each.abs().max()) for each in angles)
    if largest <= 2.0 * math.pi:
        raise UserError(f"{motion.source} has no angle above {largest:.1f}: it may be in radians; give it in degrees")


def _resampled(values: torch.Tensor, frame_rate: float, *, root: bool) -> torch.Tensor:
    """Values at :data:`FRAME_RATE`, on straight lines between those given; shape [frames, channels].

    Args:
        values: Angles [deg], after three positions in the row of the root.
        frame_rate: Their rate [Hz].
        root: Whether they are the root's.
    """
    angles = values[:, 3:] if root else values
    # An angle that jumps by a full turn has not moved.
    unwrapped = torch.from_numpy(np.unwrap(angles.numpy(), period=360.0, axis=0))
    steady = torch.cat((values[:, :3], unwrapped), dim=1) if root else unwrapped
    duration = (len(values) - 1) / frame_rate
    place = torch.arange(math.floor(duration * FRAME_RATE + 1e-6) + 1, dtype=values.dtype) * (frame_rate / FRAME_RATE)
    before = place.floor().long().clamp(max=len(values) - 2)
    share = (place - before).unsqueeze(1)
    return (1.0 - share) * steady[before] + share * steady[before + 1]


def _frame(path: Path, start: int, lines: list[tuple[int, list[str]]], skeleton: Skeleton) -> dict[str, list[float]]:
    """One frame's values, checked against the skeleton; ``start`` is the line of the frame's number."""
    expected = skeleton.channels()
    frame: dict[str, list[float]] = {}
    for place, (name, *words) in lines:
        where = f"{path} line {place}"
        if name not in expected:
            state = "has no degree of freedom in" if name in skeleton.bones else "is unknown to"
            raise UserError(f"{where}: {name} {state} {skeleton.source}; give the skeleton of this motion's subject")
        if name in frame:
            raise UserError(f"{where}: bone {name} stands twice in one frame; the file is broken, fetch it again")
        if len(words) != expected[name]:
            raise UserError(
                f"{where}: bone {name} has {len(words)} values, {skeleton.source} wants {expected[name]}; give the"
                " skeleton of this motion's subject or fetch the file again"
            )
        try:
            frame[name] = _numbers(words)
        except ValueError as error:
            raise UserError(f"{where}: bone {name} has a value that is no finite number: {error}") from error
    missing = [name for name in expected if name not in frame]
    if missing:
        raise UserError(
            f"{path} line {start}: the frame lacks bone {missing[0]} of {skeleton.source}; give the skeleton of this"
            " motion's subject or fetch the file again"
        )
    return frame


def _cut_short(lines: list[tuple[int, list[str]]], skeleton: Skeleton) -> bool:
    """Whether a bad last frame merely ends early: all but its last line are good, and nothing has a value too many."""
    expected = skeleton.channels()
    good = all(len(words) - 1 == expected.get(words[0]) for _, words in lines[:-1])
    last = lines[-1][1] if lines else [""]
    begins = any(name.startswith(last[0]) and len(last) - 1 <= count for name, count in expected.items())
    try:
        for _, words in lines[:-1]:
            _numbers(words[1:])
        _numbers(last[1:-1])  # the very last may be cut in its middle
    except ValueError:
        return False
    cut = len(last) == 1 or re.fullmatch(r"[-+0-9.eE]+", last[-1]) is not None
    return good and begins and cut and len(lines) <= len(expected)
