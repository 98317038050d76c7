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


def clip_of(subject, frames):
    """A motion on the skeleton, as the command reads it."""
    skeleton = read_skeleton(subject.skeleton)
    motion = read_motion(subject.motion("walk.amc", frames), skeleton)
    check_clip(motion)
    return retarget(skeleton, motion, flat_soles(skeleton, motion))


def walk(subject, **changes):
    """A walk that goes otherwise than people do."""
    return clip_of(subject, subject.stride_frames(0.9, 2.5, **changes))


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


@pytest.mark.parametrize("degrees", [90.0, -90.0, 180.0])
def test_the_pelvis_faces_where_it_goes(subject, degrees: float):
    """A crossing of the laboratory at an angle is none of it: there both turn."""
    frames = turned(subject.stride_frames(0.9, 2.5), degrees)
    with pytest.raises(UserError, match=rf"faces {abs(degrees):.0f} degrees away"):
        gait_cycle(clip_of(subject, frames), "walk")


def bent(frames, headings):
    """Frames of a subject whose steps go in these directions [deg], as it faces."""
    x = z = before = 0.0
    turned_frames = []
    for frame, heading in zip(frames, headings, strict=True):
        _, y, ahead, *_ = frame["root"]
        x += (ahead - before) * math.sin(math.radians(heading))
        z += (ahead - before) * math.cos(math.radians(heading))
        before = ahead
        turned_frames.append({**frame, "root": (x, y, z, 0.0, heading, 0.0)})
    return turned_frames


def test_a_crossing_at_an_angle_is_taken(subject):
    """Root and heading turned together."""
    frames = bent(subject.stride_frames(0.9, 2.5), [70.0] * 300)
    assert gait_cycle(clip_of(subject, frames), "walk").gait.speed > 1.0


@pytest.mark.parametrize("seconds", [1.8, 2.5, 5.0])
@pytest.mark.parametrize("degrees", [10.0, 40.0, -90.0, 360.0])
def test_a_clip_that_turns_is_refused_with_its_angle(subject, degrees: float, seconds: float):
    """Whether it is a stride long or five; ten degrees are within what people do on a straight walk."""
    frames = subject.stride_frames(0.9, seconds)
    clip = clip_of(subject, bent(frames, [degrees * index / len(frames) for index in range(len(frames))]))
    if degrees == 10.0:
        gait_cycle(clip, "walk")
        return
    with pytest.raises(UserError, match=r"walk turns by \d+ degrees; give a clip that goes straight ahead") as refusal:
        gait_cycle(clip, "walk")
    assert float(str(refusal.value).split()[3]) == pytest.approx(abs(degrees), rel=0.1)


def test_a_clip_that_turns_and_turns_back_is_refused(subject):
    """At its end it faces where it faced at its beginning."""
    frames = subject.stride_frames(0.9, 6.0)
    clip = clip_of(
        subject, bent(frames, [60.0 * math.sin(math.pi * index / len(frames)) for index in range(len(frames))])
    )
    with pytest.raises(UserError, match=r"walk turns by \d+ degrees"):
        gait_cycle(clip, "walk")


@pytest.mark.parametrize("scale", [0.3937, 0.7, 1.4, 2.54])
def test_a_stance_foot_stands_still(subject, scale: float):
    """A root in other units or another scale than the bones, and a treadmill that moves less than it says."""
    match = r"the feet of walk slide over the ground at \d\.\d\d m/s or more while the pelvis goes at \d\.\d\d m/s"
    with pytest.raises(UserError, match=match):
        gait_cycle(walk(subject, scale=scale), "walk")


@pytest.mark.parametrize(("before", "after"), [(1.0, 0.0), (0.0, 0.6), (0.5, 1.0)])
def test_a_clip_that_begins_or_ends_standing_is_told_what_to_cut(subject, before: float, after: float):
    """In seconds; what is cut there walks on."""
    frames = subject.stride_frames(0.9, 3.5)
    first, last = round(120 * before), round(120 * after)
    stood = [frames[0]] * first + frames + [frames[-1]] * last
    with pytest.raises(UserError, match="walk does not walk or run from end to end; cut its") as refusal:
        gait_cycle(clip_of(subject, stood), "walk")
    told = [float(word) for word in str(refusal.value).split() if word[0].isdigit()]
    assert told == pytest.approx([time for time in (before, after) if time], abs=0.25)
    kept = stood[round(120 * told[0]) if before else 0 : len(stood) - (round(120 * told[-1]) if after else 0)]
    gait_cycle(clip_of(subject, kept), "walk")


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
        run=subject.motion("run.amc", subject.stride_frames(1.35, 1.5)),
        out=subject.folder / "net.pt",
    )
    with pytest.raises(UserError, match="the pelvis of walk faces 180 degrees away"):
        fit(settings)
    assert not list(subject.folder.glob("net*"))
