"""ODrive axes on CANSimple: their cyclic frames, and the master that runs them."""
