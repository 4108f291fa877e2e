"""Policies: how long their inference may take, with each merge of chunks."""
