"""The humanoid's fingerprint: over what its file means."""

from pathlib import Path

import pytest

from aicpg_newton.errors import UserError
from aicpg_newton.robot import humanoid
from aicpg_newton.robot.fingerprint import facts, fingerprint
from aicpg_newton.robot.humanoid import MJCF_PATH
from aicpg_newton.robot.mjcf import checked


def variant(folder: Path, old: str, new: str) -> Path:
    """The humanoid's file with a change."""
    text = MJCF_PATH.read_text(encoding="utf-8")
    assert old in text
    path = folder / "variant.xml"
    path.write_bytes(text.replace(old, new).encode())
    return path


def test_it_is_the_one_that_shipped_networks_were_trained_on():
    """To change it voids them."""
    assert fingerprint() == "5c9e39e9b196"


@pytest.mark.parametrize(
    ("old", "new"),
    [("\n", "\r\n"), ("<worldbody>", "<!-- a remark --><worldbody>"), ('mass="3.9"', 'mass="3.90"'), ("    ", "\t")],
    ids=["CRLF", "comment", "spelling", "tabs"],
)
def test_how_the_file_is_written_does_not_count(old: str, new: str, tmp_path: Path):
    """Nor does the order of its bodies."""
    assert fingerprint(variant(tmp_path, old, new)) == fingerprint()


def test_the_order_of_bodies_does_not_count(permuted_mjcf: Path):
    """Joints and links go by name everywhere."""
    assert fingerprint(permuted_mjcf) == fingerprint()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('mass="3.9"', 'mass="3.91"'),
        ('range="-60 90"', 'range="-60 91"'),
        ('pos="0 0 0.224"', 'pos="0 0 0.225"'),
        ('size="0.11"', 'size="0.111"'),
        ('axis="0 0 1" range="-45 45"', 'axis="0 0 -1" range="-45 45"'),
        ("right_clavicle", "right_collarbone"),
    ],
)
def test_what_it_means_counts(old: str, new: str, tmp_path: Path):
    """Masses, ranges, places, sizes, axes and names."""
    assert fingerprint(variant(tmp_path, old, new)) != fingerprint()


@pytest.mark.parametrize("table", ["JOINT_GROUPS", "HEAD_CENTRE", "CONTROL_RATE"])
def test_gains_and_the_heads_position_count(table: str, monkeypatch: pytest.MonkeyPatch):
    """They are not in the file."""
    before = facts()
    changed = {
        "JOINT_GROUPS": {**humanoid.JOINT_GROUPS, "knee": humanoid.JOINT_GROUPS["hip"]},
        "HEAD_CENTRE": (0.0, 0.0, 0.18),
        "CONTROL_RATE": 50.0,
    }
    monkeypatch.setattr(humanoid, table, changed[table])
    assert facts() != before


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<worldbody>", '<include file="/etc/passwd"/><worldbody>', "has an <include>"),
        ("<worldbody>", '<include file="other.xml"/><worldbody>', "has an <include>"),
        (
            "<worldbody>",
            '<asset><mesh file="/other/a.stl"/></asset><worldbody>',
            "names '/other/a.stl', outside",
        ),
        ("<worldbody>", '<asset><mesh file="C:\\a.stl"/></asset><worldbody>', "outside of its own folder"),
        ("<worldbody>", '<asset><texture file="../a.png"/></asset><worldbody>', "outside of its own folder"),
        ('angle="degree"', 'angle="degree" meshdir="/root"', "names '/root', outside"),
        ("<worldbody>", "<extension><plugin plugin='x'/></extension><worldbody>", "has an <extension>"),
        ("<mujoco", '<!DOCTYPE a [<!ENTITY b "c">]><mujoco', "declares XML entities"),
        ("</mujoco>", "", "is not well-formed XML"),
        ("mujoco", "urdf", "begins with <urdf>"),
        ('type="sphere"', 'type="spear"', "is not MJCF"),
    ],
)
def test_files_that_reach_for_others_are_refused(old: str, new: str, message: str, tmp_path: Path):
    """Before anything reads them in earnest."""
    with pytest.raises(UserError, match=message):
        checked(variant(tmp_path, old, new))


def test_huge_and_missing_files(tmp_path: Path):
    """One sentence each."""
    with pytest.raises(UserError, match="there is no file"):
        checked(tmp_path / "nothing.xml")
    (tmp_path / "huge.xml").write_bytes(b" " * 5_000_000)
    with pytest.raises(UserError, match="is larger than 4 MB"):
        checked(tmp_path / "huge.xml")
