"""A Universal Robots e-Series controller, as far as ``ur-rtde`` uses it.

RTDE (port 30004), the script port (30003) and the dashboard (29999). No URScript is interpreted: an
uploaded program whose name is ``rtde_control`` stands for the commands in its registers.
"""
