"""Certificates: the proved gain of a law and the region where it holds, and the checker that proves them again."""

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
