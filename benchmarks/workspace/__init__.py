"""A controller judged as a robot is used: random goals over the whole joint range, through a real loop; see `__main__`.

``arm`` holds a robot's numbers and its rigid-body dynamics by Pinocchio, ``plants`` two simulators that share no code
with flexhinf, ``goals`` the moves, ``laws`` what is compared, ``product`` the laws of flexhinf, ``linear`` damping and
margins at random poses, ``trip`` one run, ``metrics`` its numbers, ``size`` the bytes of an exported law, ``rows`` what
is kept of all, ``parallel`` several at a time, ``gamma`` a study of γ, ``masses`` one of errors of masses,
``tables`` the tables of the docs.
"""
