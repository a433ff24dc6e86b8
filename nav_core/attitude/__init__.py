"""Attitude: how it is carried along by measured angular rate, kept a rotation, and written as angles.

``propagation`` integrates quaternions and direction cosines, ``orthonormal`` repairs what integration has bent,
``euler_rates`` has the equations of the angles themselves and the way through gimbal lock, ``kernels`` the
compiled pieces that sequential algorithms are made of.  Conversions are in `nav_core.rotation`.

Filters: ``error_state`` (002: quaternion and bias by their errors, star tracker or directions), ``quaternion_ekf``
(000: seven states), ``vertical`` (gravity freed from the vehicle's acceleration by GPS), ``control_unit`` (000's modes,
resets and rejections around them).
"""
