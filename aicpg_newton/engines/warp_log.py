"""Import this beside Warp or Newton: what they write, to the console and to the disk.

No start-up banner and no line for every kernel module that is loaded. Where the folder of compiled kernels cannot be
written to, as in a container with a read-only root, they go into a temporary one.
"""

import atexit
import os
import shutil
import sys
import tempfile

import warp as wp

from aicpg_newton.errors import UserError


def _start_warp() -> None:
    """Start Warp with a folder for compiled kernels that can be written to.

    One that holds kernels is kept: they may have been compiled before on purpose.

    Raises:
        UserError: There is no such folder.
    """
    try:
        wp.init()
        folder = wp.config.kernel_cache_dir or ""
        os.fsencode(folder).decode("utf-8")
        if not folder or os.access(folder, os.W_OK | os.X_OK) or os.listdir(folder):
            return
        reason = f"{folder} may not be written to"
    except OSError as error:
        reason = f"{error.filename} cannot be made or read: {error.strerror}"
    except UnicodeError:
        reason = f"{wp.config.kernel_cache_dir} holds bytes that are not UTF-8"
    try:
        temporary = tempfile.mkdtemp(prefix="aicpg_newton_kernels_")
    except OSError as error:
        raise UserError(
            f"there is no folder for compiled kernels ({reason}), and no temporary one can be made ({error.strerror});"
            " set WARP_CACHE_PATH or TMPDIR to a folder that can be written to"
        ) from error
    owner = os.getpid()
    atexit.register(lambda: shutil.rmtree(temporary, ignore_errors=True) if os.getpid() == owner else None)
    wp.config.kernel_cache_dir = temporary
    wp.init()
    print(
        f"Compiled kernels go into a temporary folder ({reason}); set WARP_CACHE_PATH to a folder to keep them.",
        file=sys.stderr,
    )


wp.config.log_level = wp.LOG_WARNING
_start_warp()
