"""One export for all tests: tracing takes a while."""

from pathlib import Path

import pytest

from aicpg_newton.export.__main__ import ExportOptions, export


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the shipped network, exported."""
    for package in ("onnxscript", "onnxruntime"):
        pytest.importorskip(package, reason=f"the extra 'export' is not installed: no {package}")
    folder = tmp_path_factory.mktemp("export")
    export(ExportOptions(out=folder))
    return folder
