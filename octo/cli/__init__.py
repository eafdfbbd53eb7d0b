"""The command line: ``octo solve | info | robots | simulate | view``.

Exit codes: 0 converged or done, 1 ran but did not converge (all files written), 2 refused, 130 interrupted.
"""
