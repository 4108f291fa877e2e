"""An ABB controller under externally guided motion (EGM), as far as ``abb-robot-client`` uses it.

The emulated RAPID program runs ``EGMRunJoint``. After a stop it waits until the client has been
silent for a second, and runs it again.
"""
