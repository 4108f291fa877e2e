"""Questions after a margin: theory, patterns of delays, disturbances, remedies."""
