"""Kinds of devices that only tests know, as those of a plug-in (see ``tests.plugins.installed.add_toys``)."""
