"""``python -m octo`` is the command ``octo``."""

from octo.cli.main import run

run()
