"""Network between the processes of a run: endpoints, keys, relays that delay."""
