"""The identical optimisation problem for other solvers: as CasADi expressions, for IPOPT and for
fatrop.

``nlp`` gives anybody the expressions, the bounds and the start, for any solver that CasADi knows;
``ipopt`` and ``fatrop`` solve it, from the same start and to the same tolerances as octo, by octo's
own compiled functions, which tests hold to the expressions. ``contact_invariant`` poses the same
task as contact-invariant optimisation does, for octo's own solvers.
"""

from octo.reference.contact_invariant import ContactInvariant, contact_invariant
from octo.reference.interior_point import Ipopt, ipopt
from octo.reference.program import Nlp, nlp
from octo.reference.run import Run
from octo.reference.stagewise import Fatrop, fatrop

__all__ = [
    "ContactInvariant",
    "Fatrop",
    "Ipopt",
    "Nlp",
    "Run",
    "contact_invariant",
    "fatrop",
    "ipopt",
    "nlp",
]
