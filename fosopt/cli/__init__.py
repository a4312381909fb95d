"""The command ``fosopt``.

Nothing heavy is imported before a command needs it, so that ``fosopt --help`` answers at once.
"""

from __future__ import annotations

import os

# Before NumPy loads: the last bits of an eigenvalue change with the number of threads, and small matrices are
# faster on one.
for _library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")


def main() -> None:
    """Run the command with the arguments of the process, and exit."""
    from fosopt.cli.commands import app

    app(prog_name="fosopt")
