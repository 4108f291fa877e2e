"""moteus controllers: multiplex frames, modes, watchdog, faults."""
