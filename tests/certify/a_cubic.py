"""A certificate in closed form, of a plant with one state: what is proved of it can be checked by hand."""

from __future__ import annotations

from flexhinf.certify import Certificate, Parameter, Signal, Start, Term

#: ẋ = p x³ + u + d, u = −x, V = x²/2: r = −x²/2 + x²/(2γ²) + h²/2 + p x⁴ < 0 for x² < (1 − 1/γ² − h²)/(2p).
CUBIC = Certificate(
    about="a cubic",
    states=(Signal("position", "m"),),
    inputs=(Signal("pull", "N"),),
    disturbances=(Signal("gust", "N"),),
    drift=((Term(1.0, (3,), (("softening", 1),)),),),
    g1=(((Term(1.0, (0,)),),),),
    g2=(((Term(1.0, (0,)),),),),
    penalty=((((1,), 0.5),),),
    r2=((1.0,),),
    value=(((2,), 0.5),),
    law=((((1,), -1.0),),),
    gamma=2.0,
    level=0.1249,  # x² < 0.25 at p = 1
    coordinates=((1.0,),),
    reach=2.0,
    parameters=(Parameter("softening", 0.5, 1.0, "N/m3"),),
    starts=(Start("released at rest", 0.499, ((Term(-1.0, (1,)),),)),),
)
