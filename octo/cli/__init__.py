"""The command line, ``octo COMMAND``: octo.cli.main has the list of commands.

Exit codes: 0 converged or done, 1 ran but did not converge (all files written), 2 refused, 130 interrupted.
"""

from __future__ import annotations

import sys
from typing import NoReturn


def run() -> NoReturn:
    """The command ``octo``."""
    try:
        from octo.cli.main import main  # here, so that Ctrl-C while NumPy and CasADi load is no traceback either

        code = main()
    except KeyboardInterrupt:
        print("\nocto: interrupted, nothing was written", file=sys.stderr)
        code = 130
    sys.exit(code)
