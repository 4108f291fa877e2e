"""A control law in a separate program, in any language: asked over a pipe at every state."""
