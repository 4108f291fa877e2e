"""CiA 402 drives on CANopen: their cyclic frames, and the master that runs them."""
