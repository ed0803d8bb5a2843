"""Kinds of devices that only tests know: one module each, and one line of a registry (see ``cellapp_with_toys``)."""
