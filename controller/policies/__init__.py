"""Policies behind a server: robot clients of LeRobot's gRPC service and of openpi's websocket."""
