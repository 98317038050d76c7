"""Reader of ASF and AMC files."""

import math

import pytest
import torch

from aicpg_newton.errors import UserError
from aicpg_newton.motion.acclaim import euler_matrix, pose, read_motion, read_skeleton

UNIT = 0.0254 / 0.45


def test_lengths_are_metres_and_bones_chain_from_the_root(subject):
    """A foot hangs thigh and shin below the hips, which are two units to the left, all in metres."""
    skeleton = read_skeleton(subject.skeleton)
    motion = read_motion(subject.motion("a.amc", [{"root": (1.0, 17.0, 3.0, 0.0, 0.0, 0.0)}]), skeleton)
    ankle = pose(skeleton, motion).ends["ltibia"][0]
    expected = torch.tensor([1.0 + 2.0, 17.0 - 15.0, 3.0], dtype=torch.float64) * UNIT
    torch.testing.assert_close(ankle, expected, atol=1e-8, rtol=0)


def test_euler_matrix_applies_x_first():
    """R = Rz Ry Rx: with 90 degrees about x and z, y goes to z and stays, z goes to -y and on to x."""
    matrix = euler_matrix(torch.tensor([90.0, 0.0, 90.0], dtype=torch.float64))
    expected = torch.tensor([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], dtype=torch.float64)
    torch.testing.assert_close(matrix, expected, atol=1e-12, rtol=0)


def test_bone_axis_turns_the_degrees_of_freedom(subject):
    """The elbow's rx in a T pose turns about the bone's own tilted axis: the forearm goes forward and up."""
    skeleton = read_skeleton(subject.skeleton)
    result = pose(skeleton, read_motion(subject.motion("a.amc", [{"lradius": (90.0,)}]), skeleton))
    forearm = (result.ends["lradius"] - result.ends["lhumerus"])[0]
    expected = torch.tensor([0.0, 0.5, math.sqrt(0.75)], dtype=torch.float64) * 4.0 * UNIT
    torch.testing.assert_close(forearm, expected, atol=1e-8, rtol=0)


def test_crlf_reads_the_same(subject):
    """Windows line ends change nothing."""
    frames = subject.stride_frames(1.0, 0.1)
    unix = read_motion(subject.motion("a.amc", frames), read_skeleton(subject.skeleton))
    subject.skeleton.write_bytes(subject.skeleton_text().replace("\n", "\r\n").encode())
    path = subject.folder / "b.amc"
    path.write_bytes(subject.motion_text(frames).replace("\n", "\r\n").encode())
    windows = read_motion(path, read_skeleton(subject.skeleton))
    assert all(torch.equal(windows.values[name], unix.values[name]) for name in unix.values)


def test_a_cut_last_frame_is_left_out_with_a_warning(subject):
    """A file that ends within its last frame keeps the whole frames before."""
    text = subject.motion_text([{}, {}, {}])
    path = subject.folder / "cut.amc"
    for cut in (
        text[: text.rindex("lradius")],
        text[: text.rindex("rhumerus") + 4],
        text[: text.rindex("lfemur") + 12],
    ):
        path.write_text(cut)
        with pytest.warns(UserWarning, match="last frame"):
            assert len(read_motion(path, read_skeleton(subject.skeleton)).values["root"]) == 2


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("2\nroot", "7\nroot", "frame 7 follows frame 1"),
        ("lradius 0.000000\nrf", "rf", "frame lacks bone lradius"),
        ("rtibia 0.000000", "rtibia 0.0 1.0", "bone rtibia has 2 values"),
        ("rtibia 0.000000", "rtibia nan", "no finite number"),
        ("rtibia 0.000000", "rtibia x1", "no finite number"),
        ("rtibia 0.000000", "rtibia -1.#IND00", "no finite number: '-1.#IND00' is no number"),
        ("rtibia 0.000000", "rtibia 1.#QNAN", "no finite number: '1.#QNAN' is no number"),
        ("rtibia 0.000000", "rtibia 1.#INF", "no finite number"),
        ("rtibia 0.000000", "rtibia 0.0#", "no finite number"),
        ("rtibia 0.000000", "rtibia 1,5", "no finite number"),
        ("rtibia 0.000000", "rtibia -nan(ind)", "no finite number"),
        ("rtibia 0.000000", "tail 0.0", "tail is unknown to subject.asf"),
        ("rtibia 0.000000", "rtibia", "bone rtibia has 0 values"),
    ],
)
def test_a_broken_middle_names_its_line(subject, old, new, message):
    """What is wrong in a middle frame is one sentence with the line."""
    text = subject.motion_text([{}, {}, {}])
    at = text.index("2\nroot")
    path = subject.folder / "bad.amc"
    path.write_text(text[:at] + text[at:].replace(old, new, 1))
    with pytest.raises(UserError, match=rf"bad.amc line \d+: .*{message}"):
        read_motion(path, read_skeleton(subject.skeleton))


def test_a_comment_begins_with_a_word(subject):
    """On a line of its own or behind values, in skeletons too."""
    text = subject.motion_text([{}, {}])
    path = subject.folder / "a.amc"
    path.write_text(
        text.replace("rtibia 0.000000", "rtibia 0.000000 # of the knee, 1.#IND").replace("2\nroot", "#\n2\nroot")
    )
    subject.skeleton.write_text(subject.skeleton_text().replace("length 7.0", "length 7.0\t#inches"))
    assert len(read_motion(path, read_skeleton(subject.skeleton)).values["root"]) == 2


def test_a_nan_in_the_last_frame_is_not_taken_for_a_cut(subject):
    """Only an early end is forgiven."""
    text = subject.motion_text([{}, {}])
    path = subject.folder / "bad.amc"
    path.write_text(text[: text.rindex("rtibia")] + "rtibia nan\n")
    with pytest.raises(UserError, match="no finite number"):
        read_motion(path, read_skeleton(subject.skeleton))


@pytest.mark.parametrize("text", ["", "hello\n", ":FULLY-SPECIFIED\n:DEGREES\n", "\x01\xff"])
def test_what_is_no_motion_is_refused(subject, text):
    """An empty or foreign file is no AMC."""
    path = subject.folder / "bad.amc"
    path.write_text(text)
    with pytest.raises(UserError, match="not an Acclaim motion"):
        read_motion(path, read_skeleton(subject.skeleton))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("angle deg", "angle rad"),
        ("axis XYZ", "axis ZYX"),
        ("order TX TY TZ", "order RX RY RZ"),
        ("length 0.45", "length 0"),
        ("length 7.0", "length nan"),
        ("length 7.0", "length 7.#IND"),
        ("length 0.45", "length 1.#QNAN"),
        ("direction 0.000000000 1.000000000", "direction 0.#IND00 1.000000000"),
        ("    root thorax\n", ""),
        ("dof rx", "dof l"),
        ("direction 0.000000000 1.000000000 0.000000000", "direction 0 0 0"),
    ],
)
def test_a_broken_skeleton_is_refused(subject, old, new):
    """Conventions other than CMU's and missing parts are errors, not wrong motions."""
    assert old in subject.skeleton_text()
    subject.skeleton.write_text(subject.skeleton_text().replace(old, new, 1))
    with pytest.raises(UserError, match=r"subject\.asf"):
        read_skeleton(subject.skeleton)


def test_a_missing_file_is_named(subject):
    """The path stands in the message."""
    with pytest.raises(UserError, match=r"there is no file .*none\.asf"):
        read_skeleton(subject.folder / "none.asf")


def test_the_cut_clip_loses_its_last_frame(mocap):
    """07_12 is cut short within frame 245."""
    skeleton = read_skeleton(mocap / "07" / "07.asf")
    with pytest.warns(UserWarning, match="245"):
        motion = read_motion(mocap / "07" / "07_12.amc", skeleton)
    assert len(motion.values["root"]) == 244
