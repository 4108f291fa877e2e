"""One of each kind of extension of funnel-hil, as a package of its own."""
