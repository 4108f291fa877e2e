"""Drives with the MIT mini-cheetah's protocol, such as CubeMars' AK series in MIT mode."""
