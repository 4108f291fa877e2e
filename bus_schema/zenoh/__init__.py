"""The link over Zenoh, in the wire format of rmw_zenoh."""
