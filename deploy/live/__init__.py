"""The live view: a run that is watched while it happens, or played back, in a browser or Foxglove.

A process of its own that only looks: it takes what the recorder passes on.
"""
