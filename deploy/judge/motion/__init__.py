"""The motion of a judged run: lags, the tip, jerk, and how chunks of targets follow each other."""
