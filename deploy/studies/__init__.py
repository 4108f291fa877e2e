"""The kinds of study that ship, a package each. The YAML files beside them define studies."""
