"""From a robot's own log to its plant: masses, rotors, friction, delays, with their intervals."""
