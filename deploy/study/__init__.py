"""Many runs: sweeps and margins."""
