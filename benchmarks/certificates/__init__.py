"""Proofs beside those that others would make: linear matrix inequalities and sums of squares, on the same claims."""
