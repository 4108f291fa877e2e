"""Sockets that stand for a CAN bus: frames over multicast, who hears them, and what they drop."""
