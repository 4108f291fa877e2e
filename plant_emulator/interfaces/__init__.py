"""Interfaces of robots that take no torque: their own controllers, between the link and the joints.

A robot's controller has its own rate and clock. At each of its cycles it reads the newest target,
if one has arrived since the last cycle, and plans its motion; the drives follow that.
"""
