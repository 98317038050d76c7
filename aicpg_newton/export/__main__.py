"""Take a trained network out of this package: python -m aicpg_newton.export --out DIR.

DIR gets controller.onnx, the whole controller from plain physics to motor commands, and humanoid.xml, a stock MuJoCo
model whose motors take them. examples/stand_alone.py shows how the two go together.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from aicpg_newton.errors import UserError, run_command
from aicpg_newton.export.controller import Controller, check_packages, write_onnx
from aicpg_newton.export.model import stock_model
from aicpg_newton.files import write_text
from aicpg_newton.learning import checkpoint
from aicpg_newton.learning.policy import Trained


@dataclass(kw_only=True)
class ExportOptions:
    """What to export, and where to."""

    checkpoint: Path | None = None
    """Trained AI-CPG network: a model_*.pt or a run folder; the best of those that ship when not given."""
    out: Path
    """Folder for controller.onnx and humanoid.xml; made where it is missing."""


def export(options: ExportOptions) -> None:
    """Write what the options ask for, and say where it is.

    Raises:
        UserError: The checkpoint cannot be read or exported, a package is missing, or the folder cannot be written to.
    """
    check_packages()
    controller = Controller(Trained.read(options.checkpoint or checkpoint.best_for("flat")))
    _make_folder(options.out)
    print("Tracing the controller takes a minute.", flush=True)
    write_onnx(controller, options.out / "controller.onnx")
    write_text(options.out / "humanoid.xml", stock_model(controller.engine, controller.motors, controller.pattern))
    print(f"wrote {options.out / 'controller.onnx'} and {options.out / 'humanoid.xml'}")


def _make_folder(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot make the folder {path} ({error.strerror}); choose another place") from error


if __name__ == "__main__":
    run_command(lambda: export(tyro.cli(ExportOptions, description=__doc__)))
