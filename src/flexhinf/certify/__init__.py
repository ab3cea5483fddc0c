"""Certificates: the proved gain of a law, the region where it holds, the checker that proves them again.

::

    GeneralisedPlant, HJISolution ─► problem_to_claim, box ─► claim ─► proof, cells ─┬─► Certificate ─► a file
                                                                                     └─► NotProved
    Certificate ─► checker ─► Verification

Enter at `certify` of `proof` for a problem with its solution, at `prove` for a claim that is stated by hand, at
`load_certificate` for a file. What decides is `checker`, whose docstring says in which order to read it.
"""

from flexhinf.certify.certificate import Certificate, load_certificate
from flexhinf.certify.checker import Verification
from flexhinf.certify.claim import FUNCTIONS, Function, Parameter, Signal, Start, Term
from flexhinf.certify.proof import NotProved, prove

__all__ = [
    "FUNCTIONS",
    "Certificate",
    "Function",
    "NotProved",
    "Parameter",
    "Signal",
    "Start",
    "Term",
    "Verification",
    "load_certificate",
    "prove",
]
