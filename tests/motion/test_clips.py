"""Clips that are not what is assumed of them: another encoding, unit, size or direction. Each is told what it is."""

import codecs
import math
import re

import pytest

from aicpg_newton.errors import UserError
from aicpg_newton.motion.__main__ import Fit, fit
from aicpg_newton.motion.acclaim import check_clip, read_motion, read_skeleton
from aicpg_newton.motion.cycles import gait_cycle
from aicpg_newton.motion.retarget import flat_soles, retarget


def walk(subject, **changes):
    """A motion on the skeleton, as the command reads it."""
    skeleton = read_skeleton(subject.skeleton)
    motion = read_motion(subject.motion("walk.amc", subject.stride_frames(0.9, 2.5, **changes)), skeleton)
    check_clip(motion)
    return retarget(skeleton, motion, flat_soles(skeleton, motion))


def turned(frames, degrees: float):
    """Frames of a subject that faces elsewhere; its legs do the same."""
    return [{**frame, "root": (*frame["root"][:4], degrees, 0.0)} for frame in frames]


def test_a_straight_walk_is_taken(subject):
    """Otherwise what follows could not fail."""
    assert gait_cycle(walk(subject), "walk").gait.frequency == pytest.approx(0.9, abs=0.005)


@pytest.mark.parametrize(
    ("speed", "rise", "message"),
    [
        (0.0, 0.0, r"does not progress \(0.00 m/s\); give a clip over ground"),
        (-40.0, 0.0, r"faces 180 degrees away from where it goes"),
        (40.0, 20.0, r"rises by 27 degrees; give a clip on a level floor"),
        (0.0, 40.0, r"rises by 90 degrees"),
    ],
)
def test_a_clip_goes_forwards_on_a_level_floor(subject, speed: float, rise: float, message: str):
    """Treadmills, backwards walks, stairs, and z for up."""
    with pytest.raises(UserError, match=message):
        gait_cycle(walk(subject, speed=speed, rise=rise), "walk")


@pytest.mark.parametrize(("degrees", "refused"), [(30.0, False), (90.0, True), (-90.0, True), (180.0, True)])
def test_the_pelvis_faces_where_it_goes(subject, degrees: float, refused: bool):
    """A crossing of the laboratory at an angle is none of it: there both turn."""
    skeleton = read_skeleton(subject.skeleton)
    frames = turned(subject.stride_frames(0.9, 2.5), degrees)
    motion = read_motion(subject.motion("walk.amc", frames), skeleton)
    clip = retarget(skeleton, motion, flat_soles(skeleton, motion))
    if refused:
        with pytest.raises(UserError, match=rf"faces {abs(degrees):.0f} degrees away"):
            gait_cycle(clip, "walk")
    else:
        gait_cycle(clip, "walk")


def test_a_crossing_at_an_angle_is_taken(subject):
    """Root and heading turned together."""
    angle = math.radians(70.0)
    frames = [
        {**frame, "root": (z * math.sin(angle), y, z * math.cos(angle), 0.0, 70.0, 0.0)}
        for frame in subject.stride_frames(0.9, 2.5)
        for _, y, z, *_ in [frame["root"]]
    ]
    skeleton = read_skeleton(subject.skeleton)
    motion = read_motion(subject.motion("walk.amc", frames), skeleton)
    assert gait_cycle(retarget(skeleton, motion, flat_soles(skeleton, motion)), "walk").gait.speed > 1.0


def test_byte_order_marks_and_line_ends_do_not_matter(subject):
    """Editors put them there."""
    text = subject.motion_text(subject.stride_frames(0.9, 2.5))
    (subject.folder / "plain.amc").write_bytes(text.encode())
    (subject.folder / "marked.amc").write_bytes(codecs.BOM_UTF8 + text.replace("\n", "\r\n").encode())
    subject.skeleton.write_bytes(codecs.BOM_UTF8 + subject.skeleton.read_bytes())
    skeleton = read_skeleton(subject.skeleton)
    plain, marked = (read_motion(subject.folder / name, skeleton) for name in ("plain.amc", "marked.amc"))
    assert all((plain.values[bone] == marked.values[bone]).all() for bone in plain.values)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (lambda text: text.encode("utf-16"), "is in UTF-16; save it as UTF-8 or ASCII"),
        (lambda text: text.encode("utf-32"), "is in UTF-32; save it as UTF-8 or ASCII"),
        (lambda text: text.encode("utf-16-be"), "is in UTF-16 or no text at all"),
        (lambda text: text.encode() + bytes(100), "holds NUL bytes, as a copy that was broken off; fetch it again"),
    ],
)
def test_other_encodings_are_named(subject, data, message: str):
    """And not blamed on the clip's content; skeletons too."""
    path = subject.folder / "walk.amc"
    path.write_bytes(data(subject.motion_text([{}] * 300)))
    with pytest.raises(UserError, match=message):
        read_motion(path, read_skeleton(subject.skeleton))
    subject.skeleton.write_bytes(data(subject.skeleton_text()))
    with pytest.raises(UserError, match=message):
        read_skeleton(subject.skeleton)


def test_radians_are_named(subject):
    """By the file's header, or by angles of which none is larger than a turn in radians."""
    skeleton = read_skeleton(subject.skeleton)
    text = subject.motion_text([{}, {}])
    path = subject.folder / "walk.amc"
    path.write_text(text.replace(":DEGREES", ":RADIANS"), encoding="utf-8")
    with pytest.raises(UserError, match="is in radians, as its header says"):
        read_motion(path, skeleton)
    path.write_text(text.replace(" 20.0", " 0.35").replace(" -20.0", " -0.35"), encoding="utf-8")
    with pytest.raises(UserError, match=r"has no angle above 0.3: it may be in radians; give it in degrees"):
        check_clip(read_motion(path, skeleton))


def test_one_frame_is_no_motion(subject):
    """Nothing can be told from it."""
    with pytest.raises(UserError, match="has 1 whole frames, which is no motion"):
        check_clip(read_motion(subject.motion("walk.amc", [{}]), read_skeleton(subject.skeleton)))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("length 7.0", "length -7.0", "lengths are positive"),
        ("length 7.0", "length 0", "lengths are positive"),
        ("length 7.0", "length inf", "'inf' is no number"),
        ("length 7.0", "length 1_0", "'1_0' is no number"),
        ("length 7.0", "length \N{ARABIC-INDIC DIGIT SEVEN}", "is no number"),
        ("length 7.0", "length 1e999", "is too large"),
        ("length 7.0", "length 1e9", "is not of this world"),
        ("length 0.45", "length -0.45", "the unit of length must be positive"),
        ("dof rx ry rz", "dof rx rx rz", "other than one each of rx, ry and rz"),
        ("name head", "name thorax", "stands twice"),
        ("root lhipjoint", "root lhipjoint lhipjoint", "has two parents"),
    ],
)
def test_skeletons_are_read_strictly(subject, old: str, new: str, message: str):
    """Lengths are positive and finite, and a number is what a careful human calls one."""
    text = subject.skeleton_text()
    assert old in text
    subject.skeleton.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(UserError, match=re.escape(message)):
        read_skeleton(subject.skeleton)


@pytest.mark.parametrize("unit", ["1.0", "0.0177", "45"])
def test_subjects_have_the_size_of_people(subject, unit: str):
    """A unit of length that is none of CMU's shows in the legs."""
    subject.skeleton.write_text(subject.skeleton_text().replace("length 0.45", f"length {unit}"), encoding="utf-8")
    if unit == "1.0":  # a child
        walk(subject)
        return
    with pytest.raises(UserError, match=r"thigh and shin of subject.asf are .* m long, but people's 0.3 to 1.4"):
        walk(subject)


def test_the_command_checks_its_clips(subject):
    """From end to end."""
    settings = Fit(
        skeleton=subject.skeleton,
        walk=subject.motion("walk.amc", subject.stride_frames(0.9, 2.5, speed=-40.0)),
        run=subject.motion("run.amc", subject.stride_frames(1.35, 1.5, speed=100.0)),
        out=subject.folder / "net.pt",
    )
    with pytest.raises(UserError, match="the pelvis of walk faces 180 degrees away"):
        fit(settings)
    assert not list(subject.folder.glob("net*"))
