"""The notebook, cell by cell."""

import json
import sys
import types
from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).resolve().parents[2] / "examples" / "walk_and_run.ipynb"


def cells() -> list[dict]:
    """All of them."""
    return json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]


def test_it_is_committed_without_outputs():
    """Which would hold pictures, and names of somebody's folders."""
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in cells() if "outputs" in cell)


@pytest.mark.slow
def test_it_runs_from_top_to_bottom(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Both gaits without a fall, a figure, and a video in the page; Jupyter itself is not needed for that."""
    pytest.importorskip("onnxruntime", reason="the extra 'export' is not installed")
    shown = []
    stub = types.ModuleType("IPython.display")
    vars(stub).update(Video=lambda path, embed: Path(path).read_bytes(), display=shown.append)
    monkeypatch.setitem(sys.modules, "IPython.display", stub)
    monkeypatch.syspath_prepend(str(NOTEBOOK.parent))
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names: dict = {}
    for cell in cells():
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
    assert capsys.readouterr().out.count("no fall") == 2
    figure, video = shown
    assert len(figure.axes) == 2
    assert video[4:8] == b"ftyp" and len(video) > 100_000
