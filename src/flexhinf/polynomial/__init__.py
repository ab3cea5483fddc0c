"""Homogeneous polynomials in compressed symmetric storage: bases, algebra, the homological equation, laws.

::

    indices of monomials ─► basis ─┬─► algebra ───► values and gradients ─► PolynomialLaw
                                   └─► truncated ─► Space: sums and products up to a degree ─► scalars

Enter at the functions of `algebra`, or at `truncated.space`.
"""
