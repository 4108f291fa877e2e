"""RTDE, the real-time data exchange of Universal Robots: packages and recipes (protocol 2)."""
