"""Commands about networks: delays of links, traces of networks, keys of link.security."""
