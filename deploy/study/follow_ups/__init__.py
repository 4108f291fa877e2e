"""Questions after a margin: patterns of delays, disturbances, remedies."""
