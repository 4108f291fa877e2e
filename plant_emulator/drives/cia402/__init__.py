"""CiA 402 servo drives on CANopen."""
