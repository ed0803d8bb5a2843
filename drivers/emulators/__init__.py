"""Servers that emulate the network protocols of real devices, for testing drivers without them."""
