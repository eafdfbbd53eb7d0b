"""The command line, ``octo COMMAND``: octo.cli.main has the list of commands.

Exit codes: 0 converged or done, 1 ran but did not converge (all files written), 2 refused, 130 interrupted.
"""

from __future__ import annotations

import sys
from typing import NoReturn

from octo.cli.interrupts import like_ctrl_c


def run() -> NoReturn:
    """The command ``octo``. SIGTERM stops it as Ctrl-C does."""
    like_ctrl_c()
    try:
        from octo.cli.main import main  # here, so that Ctrl-C while NumPy and CasADi load is no traceback either

        code = main()
    except KeyboardInterrupt as stop:
        print(f"\nocto: interrupted, {str(stop) or 'nothing was written'}", file=sys.stderr)
        code = 130
    sys.exit(code)
