"""``python -m octo`` is the command ``octo``."""

from octo.cli import run

run()
