"""A control law in a program of its own, in any language: asked over a pipe at every state."""
