"""moteus controllers (mjbots): their cyclic frames, registers and master."""
