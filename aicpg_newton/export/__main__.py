"""Take a trained network out of this package: python -m aicpg_newton.export --out DIR, or --web DIR for a page.

--out writes controller.onnx, the whole controller from plain physics to motor commands, and humanoid.xml, a stock
MuJoCo model whose motors take them; examples/stand_alone.py shows how the two go together. --web builds a page that
any static host can serve and that does all of it in the browser.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from aicpg_newton.errors import UserError, run_command
from aicpg_newton.export.requirements import check_packages, check_source
from aicpg_newton.files import make_folder, write_text
from aicpg_newton.learning import checkpoint
from aicpg_newton.learning.policy import Trained


@dataclass(kw_only=True)
class ExportOptions:
    """What to export, and where to."""

    checkpoint: Path | None = None
    """Trained AI-CPG network: a model_*.pt or a run folder; the best of those that ship when not given."""
    out: Path | None = None
    """Folder for controller.onnx and humanoid.xml; made where it is missing."""
    web: Path | None = None
    """Folder for the page, likewise; building it takes Node.js and, the first time, the npm registry."""


def export(options: ExportOptions) -> None:
    """Write what the options ask for, and say where it is.

    Raises:
        UserError: The checkpoint cannot be read or exported, a package is missing, or the folder cannot be written to.
    """
    if options.out is None and options.web is None:
        raise UserError("nothing to do; give --out DIR for the model's files or --web DIR for a page")
    check_packages()
    if options.web is not None:
        check_source()
    trained = Trained.read(options.checkpoint or checkpoint.best_for("flat"))

    # here: engines and rsl_rl take seconds to load, and what is above may be wrong
    from aicpg_newton.export.controller import Controller, write_onnx
    from aicpg_newton.export.model import stock_model
    from aicpg_newton.export.web import write_page

    controller = Controller(trained)
    folders = [folder for folder in (options.out, options.web) if folder is not None]
    for folder in folders:
        make_folder(folder)
    if options.web is not None:
        write_page(controller, options.web)
    print("Tracing the controller takes up to a minute.", flush=True)
    write_onnx(controller, [folder / "controller.onnx" for folder in folders])
    for folder in folders:
        write_text(folder / "humanoid.xml", stock_model(controller.engine, controller.motors, controller.pattern))
        print(f"wrote {folder}")
    if options.web is not None:
        print(f"To look at the page: python -m http.server --directory {options.web}")


if __name__ == "__main__":
    run_command(lambda: export(tyro.cli(ExportOptions, description=__doc__)))
