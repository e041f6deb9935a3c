"""Folders of training runs as archives: pack, unpack and show them."""
