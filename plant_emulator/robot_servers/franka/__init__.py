"""A Franka arm's controller behind libfranka's research interface, as ``pylibfranka`` uses it."""
