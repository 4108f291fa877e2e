"""What a judged run shows beside its bounds: chattering, growth, stalls, delays, a loss."""
