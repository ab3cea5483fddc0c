"""
A scalar Hamilton–Jacobi–Isaacs equation, solved beside its closed form
=======================================================================

The plant :math:`\\dot x = x - x^3 + d + u` with :math:`z = (x, u)` has a value function in closed form. The series that
``flexhinf.solve_hji`` computes comes closer to it with every degree, up to its radius of convergence.
"""

import matplotlib.pyplot as plt
import numpy as np

import flexhinf as fh

# %%
# f, the columns of disturbance and input, and z are polynomials, stated by their exponents. γ is twice the smallest.
plant = fh.PolynomialPlant({(1,): [1.0], (3,): [-1.0]}, g1=[[1.0]], g2=[[1.0]], h={(1,): [1.0]}, r2=1.0)
gamma = 2.0 * fh.smallest_gamma(plant)
laws = {degree: fh.solve_hji(plant, gamma, degree) for degree in (2, 4, 8, 16)}

# %%
# The exact law is :math:`u = -V_x = -(f + \\sqrt{f^2 + s x^2})/s` with :math:`s = 1 - 1/\\gamma^2`.
x = np.linspace(-1.4, 1.4, 281)
f, s = x - x**3, 1.0 - 1.0 / gamma**2
exact = -(f + np.sign(x) * np.sqrt(f**2 + s * x**2)) / s
errors = {}
figure, axes = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
axes.plot(x, exact, "k", linewidth=3.0, alpha=0.35, label="closed form")
for degree, solution in laws.items():
    law = solution.law(x[:, None])[:, 0]
    errors[degree] = float(np.abs(law - exact)[np.abs(x) <= 0.5].max())
    axes.plot(x, law, label=f"V of degree {degree}")
axes.set(xlabel="state x", ylabel="input u", ylim=(-4.0, 4.0))
axes.legend()
axes.grid(alpha=0.3)

# %%
# Each time the degree doubles, the error up to :math:`|x| = 0.5` falls to a thirtieth or less.
for degree, error in errors.items():
    print(f"degree {degree:2d}: largest error up to |x| = 0.5: {error:.1e}")
