"""EGM, the externally guided motion of ABB's robots: messages of protobuf over UDP."""
