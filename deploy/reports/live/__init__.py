"""The live view: a run in progress, or a recorded one, in a browser or Foxglove.

It is a separate, passive process, which receives snapshots from the recorder.
"""
