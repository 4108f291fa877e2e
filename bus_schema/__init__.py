"""The contract between both sides of the bus: messages, configuration, and links."""
