"""Answers of the dashboard port (29999): one line for each line."""

from __future__ import annotations

from plant_emulator.robot_servers.universal_robots.control_script import BY, ControlScript
from plant_emulator.robot_servers.universal_robots.rtde_port import VERSION

GREETING = "Connected: Universal Robots Dashboard Server"
FAREWELL = "Disconnected"
"""The answer to `quit`, after which the server closes the connection."""
_ANSWERS = {
    "is in remote control": "true",
    "robotmode": "Robotmode: RUNNING",
    "safetymode": "Safetymode: NORMAL",
    "safetystatus": "Safetystatus: NORMAL",
    "polyscopeversion": f"URSoftware {'.'.join(map(str, VERSION))} (emulated)",
    "get robot model": "UR5",
    "get serial number": "0",
    "power on": "Powering on",
    "brake release": "Brake releasing",
    "unlock protective stop": "Protective stop releasing",
    "close safety popup": "closing safety popup",
    "close popup": "closing popup",
    "quit": FAREWELL,
}


def answer(line: str, script: ControlScript) -> str:
    """Return the answer to a line; `stop` ends the program."""
    words = line.strip()
    command = words.lower()
    if command == "stop":
        script.end(f"{BY}dashboard")
        return "Stopped"
    if command == "running":
        return f"Program running: {str(script.is_running).lower()}"
    if command == "programstate":
        return "PLAYING rtde_control" if script.is_running else "STOPPED <unnamed>"
    if command.startswith("popup"):
        return "showing popup"
    return _ANSWERS.get(command, f"could not understand: '{words[:80]}'")
