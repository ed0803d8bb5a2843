"""Kinds of devices that only tests know, as of a plug-in (see ``tests.interfaces.plugins.installed.add_toys``)."""
