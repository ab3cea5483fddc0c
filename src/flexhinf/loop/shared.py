"""Numbers that the controller and the signals share."""

from __future__ import annotations

#: Path time while a motion is braked to rest, in units of the braking time, as a polynomial of the fraction of it that
#: has passed: half of the path time of the same interval. Its rate falls from 1 to 0 with three continuous derivatives,
#: so that the torque of an elastic joint, which the fourth derivative of the position enters, does not jump.
BRAKING = (0.0, 1.0, 0.0, 0.0, 0.0, -7.0, 14.0, -10.0, 2.5)
