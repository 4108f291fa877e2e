"""ODrive axes speaking CANSimple."""
