"""Navigation, mounting and crash numerics for vehicle telemetry boxes.

Everything here is pure: arrays in, frozen records out; no files, clocks, logging or
hidden randomness.  A caller that wants reproducible noise passes a generator.

Frames
------
A
    Box ("accelerometer") triad: accelerometer, gyro and magnetometer alike.
V
    Vehicle: x forward, y right, z down (SAE J211).
T
    Local tangent: north, east, down.
e, i
    Earth-centred Earth-fixed; inertial.
n, w
    Local-level and wander-azimuth navigation frames.

``vec_a`` is a vector in frame a.  ``R_xy`` maps frame y to frame x: ``vec_x = R_xy @ vec_y``.

Symbols
-------
f
    Specific force, m/s².  At rest and level ``f_v = (0, 0, -g)``.  It is not an acceleration.
w
    Angular rate, rad/s.  ``w_z > 0`` is a right turn (z is down); then ``f_y = +v * w_z``.
R_va
    The mounting: ``f_v = R_va @ f_a``.
R_tv
    Vehicle attitude, "t from v".
theta, phi, psi
    The thesis' mounting angles, ``R_va = Ry(theta) @ Rz(phi) @ Rx(psi)``; see `nav_core.rotation`.
course
    Direction of travel, radians clockwise from true north.
g
    Magnitude of gravity, m/s².

Units are SI and radians.  Degrees, km/h and g appear only at the edges of the product,
always with the unit in the name.

References
----------
"001" is the thesis on installation angles of a black box, "000" the one on low-cost
GPS/INS, "002" the one on an attitude platform, "003" and "004" the lecture decks; see
``docs/equations.md`` for the numbered equations and their corrections.
"""
