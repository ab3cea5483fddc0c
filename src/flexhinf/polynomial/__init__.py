"""Homogeneous polynomials in compressed symmetric storage: bases, algebra, the homological equation, laws."""
